"""Frozen dataclasses that are made in a quarter of the time.

`dataclasses.dataclass` writes the source text of up to six methods of a class and compiles each:
6 % of the CPU time of a run of two frames. Here only `__init__` is compiled; all classes share the
other methods.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from operator import attrgetter
from typing import Any, NoReturn, TypeVar, dataclass_transform

T = TypeVar("T")


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def frozen(*, eq: bool = True, kw_only: bool = False) -> Callable[[type[T]], type[T]]:
    """As `dataclass(frozen=True, eq=eq, kw_only=kw_only)`; what the class defines itself stays."""

    def made(given: type[T]) -> type[T]:
        cls: Any = dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=kw_only)(given)
        fields = dataclasses.fields(cls)
        methods = {"__init__": _initialiser(cls, fields), "__repr__": _repr}
        methods |= {"__setattr__": _refuse, "__delattr__": _refuse}
        if eq:
            values: Callable[[Any], Any] = attrgetter(*(each.name for each in fields))
            methods["__hash__"] = lambda self: hash(values(self))
            methods["__eq__"] = lambda self, other: (
                values(self) == values(other)
                if other.__class__ is self.__class__
                else NotImplemented
            )
        for name, method in methods.items():
            if name not in given.__dict__:
                setattr(cls, name, method)
        return given

    return made


def _initialiser(cls: type, fields: tuple[dataclasses.Field[Any], ...]) -> Callable[..., None]:
    """`__init__`: parameters that are keywords only come last."""
    known: dict[str, Any] = {"_set": object.__setattr__, "_missing": dataclasses.MISSING}
    parameters: list[str] = ["self"]
    lines = []
    for each in sorted(fields, key=lambda each: bool(each.kw_only)):
        name, value = each.name, each.name
        if each.kw_only and "*" not in parameters:
            parameters.append("*")
        if each.default_factory is not dataclasses.MISSING:
            known[f"_of_{name}"] = each.default_factory
            value = f"_of_{name}() if {name} is _missing else {name}"
            parameters.append(f"{name}=_missing")
        elif each.default is not dataclasses.MISSING:
            known[f"_of_{name}"] = each.default
            parameters.append(f"{name}=_of_{name}")
        else:
            parameters.append(name)
        lines.append(f"    _set(self, {name!r}, {value})")
    made: dict[str, Any] = {}
    exec("\n".join([f"def __init__({', '.join(parameters)}):", *lines]), known, made)
    init: Callable[..., None] = made["__init__"]
    init.__qualname__ = f"{cls.__qualname__}.__init__"
    return init


def _refuse(self: object, name: str, *_: object) -> NoReturn:
    raise dataclasses.FrozenInstanceError(f"{name} of {type(self).__name__} cannot be changed")


def _repr(self: Any) -> str:
    values = (f"{each.name}={getattr(self, each.name)!r}" for each in dataclasses.fields(self))
    return f"{type(self).__qualname__}({', '.join(values)})"
