"""Frozen dataclasses of `vo.base.frozen` behave as those of the standard library."""

from __future__ import annotations

import pickle
from dataclasses import FrozenInstanceError, asdict, dataclass, field, fields, replace
from typing import Any

import pytest

from vo.base.frozen import frozen


@frozen()
class Ours:
    a: int
    b: tuple[int, ...] = (1, 2)
    c: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Standard:
    a: int
    b: tuple[int, ...] = (1, 2)
    c: dict[str, int] = field(default_factory=dict)


@frozen(eq=False)
class Base:
    x: int = 0
    late: int = field(default=5, kw_only=True)


@frozen(eq=False)
class Derived(Base):
    y: int = 1

    def __repr__(self) -> str:
        return "own"


@frozen(kw_only=True)
class Named:
    x: int
    y: int = 2


def test_it_has_the_values_of_a_standard_dataclass() -> None:
    for arguments, words in (((3,), {}), ((3, ()), {"c": {"d": 1}}), ((), {"a": 4})):
        ours: Any = Ours(*arguments, **words)
        standard: Any = Standard(*arguments, **words)
        assert asdict(ours) == asdict(standard)
        assert repr(ours) == repr(standard).replace("Standard", "Ours")
    assert [each.name for each in fields(Ours)] == ["a", "b", "c"]
    assert Ours(1).c is not Ours(1).c
    assert Ours.b == (1, 2)


def test_it_is_equal_by_its_values_or_to_itself_only() -> None:
    assert Ours(1) == Ours(1) != Ours(2)
    assert Ours(1) != Standard(1)
    assert hash(Named(x=1)) == hash(Named(x=1))
    assert len({Named(x=1), Named(x=1), Named(x=2)}) == 2
    assert Base(1) != Base(1)


def test_it_cannot_be_changed() -> None:
    ours: Any = Ours(1)
    with pytest.raises(FrozenInstanceError, match="a of Ours"):
        ours.a = 2
    with pytest.raises(FrozenInstanceError, match="new of Ours"):
        ours.new = 2
    with pytest.raises(FrozenInstanceError, match="a of Ours"):
        del ours.a
    assert ours == Ours(1)


def test_it_can_be_replaced_and_pickled() -> None:
    assert replace(Ours(1), a=2) == Ours(2)
    assert pickle.loads(pickle.dumps(Ours(1, (3,)))) == Ours(1, (3,))


def test_it_refuses_wrong_arguments() -> None:
    wrong: Any = Named
    with pytest.raises(TypeError, match=r"Named\.__init__\(\) missing 1 required keyword"):
        wrong()
    with pytest.raises(TypeError, match="positional"):
        wrong(1)


def test_it_inherits_fields_and_keeps_methods_of_the_class() -> None:
    derived = Derived(3, 4, late=6)
    assert (derived.x, derived.y, derived.late) == (3, 4, 6)
    assert Derived().late == 5
    assert repr(derived) == "own"
    assert repr(Base()) == "Base(x=0, late=5)"
