"""Commands whose parameters may be blocks of options.

A block is declared once, and every command with such options has a parameter of its type. The
command line sees the fields of a block in its place, so their order is that of `--help`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, Field, field, fields, is_dataclass
from functools import cache, update_wrapper
from typing import (
    Annotated,
    Any,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import typer

from vo.base.frozen import frozen

_EMPTY = inspect.Parameter.empty
_T = TypeVar("_T")


def option(
    help: str,
    *flags: str,
    default: Any = MISSING,
    default_factory: Any = MISSING,
    panel: str | None = None,
    **more: Any,
) -> Any:
    """A field of a block, or a parameter, that is an option; others as for `typer.Option`.

    Without a heading of its own it is below that of its block in `--help`.
    """
    metadata = {"kind": typer.Option, "flags": flags, "panel": panel, "help": help, **more}
    return _field(default, default_factory, metadata)


def argument(
    help: str, *, default: Any = MISSING, default_factory: Any = MISSING, **more: Any
) -> Any:
    """A field of a block, or a parameter, that is an argument; others as for `typer.Argument`."""
    return _field(default, default_factory, {"kind": typer.Argument, "help": help, **more})


def _field(default: Any, factory: Any, metadata: dict[str, Any]) -> Any:
    if factory is not MISSING:
        return field(default_factory=factory, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(option, argument))
def block(panel: str | None = None) -> Callable[[type[_T]], type[_T]]:
    """A frozen dataclass of options, below this heading in `--help`."""

    def made(given: type[_T]) -> type[_T]:
        given.__panel__ = panel  # type: ignore[attr-defined]
        return frozen(kw_only=True)(given)

    return made


class Only:
    """Of the fields of a block, those that a command has, in this order."""

    def __init__(self, *names: str) -> None:
        self.names = names


class CommandFunction:
    """A function for typer, without blocks; they are looked at when the command is prepared.

    Args:
        function: the command.
        extra: options that are for typer alone.
    """

    def __init__(self, function: Callable[..., None], *extra: inspect.Parameter) -> None:
        update_wrapper(self, function)
        del self.__dict__["__wrapped__"]  # its parameters are others
        self.__annotations__ = {}
        self._function = function
        self._extra = extra

    @property
    def __signature__(self) -> inspect.Signature:
        hints = get_type_hints(self._function, include_extras=True)
        return inspect.Signature(
            [
                parameter
                for name, given in inspect.signature(self._function).parameters.items()
                for parameter in _parameters(name, hints[name], given.default)
            ]
            + list(self._extra)
        )

    def __call__(self, **given: Any) -> None:
        """Call the function with its blocks, made of what typer has parsed."""
        hints = get_type_hints(self._function, include_extras=True)
        names = inspect.signature(self._function).parameters
        self._function(**{name: _value(name, hints[name], given) for name in names})


def _block(hint: Any) -> tuple[Any, tuple[str, ...]]:
    """The block of a hint and the names of its fields; None for a plain option."""
    kind, *extras = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    if not (isinstance(kind, type) and is_dataclass(kind)):
        return None, ()
    chosen = [extra.names for extra in extras if isinstance(extra, Only)]
    return kind, chosen[0] if chosen else tuple(_fields(kind))


@cache
def _fields(block: type) -> Mapping[str, tuple[Any, Any]]:
    """Hint and default of each field."""
    hints = get_type_hints(block, include_extras=True)
    return {each.name: _declared(block, hints[each.name], each) for each in fields(block)}


def _declared(block: Any, hint: Any, given: Field[Any]) -> tuple[Any, Any]:
    """The hint of an option or argument with what typer reads of it, and its default."""
    more = dict(given.metadata)
    if more:
        kind, flags = more.pop("kind"), more.pop("flags", ())
        if kind is typer.Option:
            more["rich_help_panel"] = more.pop("panel") or getattr(block, "__panel__", None)
        hint = Annotated[hint, kind(*flags, **more)]
    return hint, _default(given.default, given.default_factory)


def _default(value: Any, factory: Any) -> Any:
    if factory is not MISSING:
        return factory()
    return _EMPTY if value is MISSING else value


def _parameters(name: str, hint: Any, default: Any) -> Iterator[inspect.Parameter]:
    block, names = _block(hint)
    if isinstance(default, Field):
        hint, default = _declared(None, hint, default)
    if block is None:
        kind = inspect.Parameter.KEYWORD_ONLY
        yield inspect.Parameter(name, kind, default=default, annotation=hint)
    for each in names:
        yield from _parameters(each, *_fields(block)[each])


def _value(name: str, hint: Any, given: Mapping[str, Any]) -> Any:
    block, names = _block(hint)
    if block is None:
        return given[name]
    return block(**{each: _value(each, _fields(block)[each][0], given) for each in names})
