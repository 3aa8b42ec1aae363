"""Parsing of YAML that may be anything: no text expands, and every error is a ValueError.

A YAML alias repeats what it refers to, and an alias may refer to aliases: 1 kB can stand for
gigabytes. The parser is recursive, and accepts numbers of any length.
"""

from __future__ import annotations

from typing import Any

import yaml

_MAX_NODES = 200_000  # with all aliases expanded
_MAX_DIGITS = 100


class SafeLoader(yaml.SafeLoader):
    """Loader of plain values, without those that expand."""

    def get_single_node(self) -> yaml.Node | None:
        """The only document; see `checked_node`."""
        return checked_node(super().get_single_node())

    def get_node(self) -> yaml.Node | None:
        """The next document; see `checked_node`."""
        return checked_node(super().get_node())

    def construct_scalar(self, node: Any) -> Any:
        r"""A value as text; halves of characters, as `\ud800`, are replaced."""
        value = super().construct_scalar(node)
        is_plain = not isinstance(value, str) or value.isascii()
        return value if is_plain else value.encode(errors="replace").decode()


def _integer(loader: SafeLoader, node: yaml.ScalarNode) -> Any:
    if len(node.value) > _MAX_DIGITS:
        raise yaml.constructor.ConstructorError(
            None, None, f"a number of {len(node.value)} digits", node.start_mark
        )
    return loader.construct_yaml_int(node)


SafeLoader.add_constructor("tag:yaml.org,2002:int", _integer)


def checked_node(root: yaml.Node | None) -> yaml.Node | None:
    """A document before its values are made.

    Raises:
        ConstructorError: an alias refers to what contains it, or there is too much in it.
    """
    sizes: dict[int, int] = {}
    if root is not None and _size(root, sizes) > _MAX_NODES:
        raise yaml.constructor.ConstructorError(
            None, None, f"aliases expand to more than {_MAX_NODES} values", root.start_mark
        )
    return root


def _size(node: yaml.Node, sizes: dict[int, int]) -> int:
    """Number of values in a node with all aliases expanded; `sizes` has those already counted."""
    known = sizes.get(id(node))
    if known == 0:
        raise yaml.constructor.ConstructorError(
            None, None, "an alias refers to what contains it", node.start_mark
        )
    if known is None:
        sizes[id(node)] = 0  # being counted
        total = 1
        if isinstance(node, yaml.SequenceNode):
            total += sum(_size(child, sizes) for child in node.value)
        elif isinstance(node, yaml.MappingNode):
            total += sum(_size(child, sizes) for pair in node.value for child in pair)
        known = sizes[id(node)] = min(total, 2 * _MAX_NODES)
    return known


def load_yaml(
    text: str, loader: type[yaml.SafeLoader] = SafeLoader, *, first_only: bool = False
) -> Any:
    """The document of a YAML text; None if it is empty.

    Args:
        text: the text.
        loader: loader with more kinds of values.
        first_only: leave further documents unread, instead of refusing them.

    Raises:
        ValueError: it is not YAML, has impossible values such as the date 2001-99-99, is nested
            too deeply, or expands too much.
    """
    made = None
    try:
        made = loader(text)
        if first_only:
            return made.get_data()  # None if there is none
        return made.get_single_data()
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from error
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except (ArithmeticError, AttributeError, LookupError, TypeError) as error:
        raise ValueError(f"a value cannot be read: {error}") from error
    finally:
        if made is not None:
            made.dispose()
