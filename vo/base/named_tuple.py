"""Named tuples that are made in a tenth of the time.

`typing.NamedTuple` compiles the annotation of each field, and the constructor, of each class:
0.1 ms each, 12 ms of the start of a run, which makes 145 of them. Here annotations stay texts, and
all constructors with the same number of parameters share their code.
"""

from __future__ import annotations

from collections import _tuplegetter  # type: ignore[attr-defined]
from collections.abc import Iterable, Mapping
from functools import cache
from types import FunctionType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from typing import NamedTuple as NamedTuple


class _Base(tuple):  # type: ignore[type-arg]
    """What all named tuples have in common, as of `collections.namedtuple`."""

    __slots__ = ()
    if TYPE_CHECKING:
        _fields: tuple[str, ...]

    @classmethod
    def _make(cls, values: Iterable[Any]) -> Any:
        """A tuple of these values, in the order of the fields."""
        made = tuple.__new__(cls, values)
        if len(made) != len(cls._fields):
            raise TypeError(f"Expected {len(cls._fields)} arguments, got {len(made)}")
        return made

    def _replace(self, **values: Any) -> Any:
        """A copy with other values of these fields."""
        made = self._make(map(values.pop, self._fields, self))
        if values:
            raise ValueError(f"Got unexpected field names: {list(values)!r}")
        return made

    def _asdict(self) -> dict[str, Any]:
        """The values by the names of their fields."""
        return dict(zip(self._fields, self, strict=True))

    def __getnewargs__(self) -> tuple[Any, ...]:
        return tuple(self)

    def __repr__(self) -> str:
        values = (f"{name}={value!r}" for name, value in zip(self._fields, self, strict=True))
        return f"{type(self).__name__}({', '.join(values)})"


class _Maker(type):
    """Makes a class of the annotated fields of a class statement, and no metaclass of it."""

    def __new__(cls, name: str, bases: tuple[type, ...], space: dict[str, Any]) -> Any:
        """A subclass of `_Base`.

        Raises:
            TypeError: a field without a default follows one that has a default.
        """
        fields = tuple(space.get("__annotations__", ()))
        defaults = {field: space[field] for field in fields if field in space}
        if fields[len(fields) - len(defaults) :] != tuple(defaults):
            raise TypeError(f"{name}: fields without default follow fields with one")
        space |= {field: _tuplegetter(index, "") for index, field in enumerate(fields)}
        space |= {"_fields": fields, "_field_defaults": defaults, "__match_args__": fields}
        space |= {"__slots__": (), "__new__": _constructor(name, fields, defaults)}
        return type(name, (_Base,), space)


def _constructor(name: str, fields: tuple[str, ...], defaults: Mapping[str, Any]) -> Any:
    shared = _shared_constructor(len(fields))
    names = ("_cls", *fields)
    code = shared.__code__.replace(co_varnames=names, co_qualname=f"{name}.__new__")
    return FunctionType(code, shared.__globals__, "__new__", tuple(defaults.values()))


@cache
def _shared_constructor(count: int) -> FunctionType:
    names = "".join(f"_{index}," for index in range(count))
    made: FunctionType = eval(
        f"lambda _cls, {names}: _new(_cls, ({names}))", {"_new": tuple.__new__}
    )
    return made


if not TYPE_CHECKING:

    class NamedTuple:
        """As `typing.NamedTuple`, in class statements."""

        def __mro_entries__(self, bases):
            return (_MADE,)

    _MADE = type.__new__(_Maker, "NamedTuple", (), {})
    NamedTuple = NamedTuple()
