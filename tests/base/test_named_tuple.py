"""Named tuples of `vo.base.named_tuple` behave as those of the standard library."""

from __future__ import annotations

import copy
import inspect
import pickle
import typing

import pytest

from vo.base.named_tuple import NamedTuple


class Ours(NamedTuple):
    """A tuple."""

    a: int
    b: tuple[int, ...] = (1, 2)
    c: str | None = None

    @property
    def total(self) -> int:
        """Sum."""
        return self.a + sum(self.b)

    @classmethod
    def of(cls, a: int) -> Ours:
        """One with this."""
        return cls(a)


class Standard(typing.NamedTuple):
    """A tuple."""

    a: int
    b: tuple[int, ...] = (1, 2)
    c: str | None = None


class Derived(Ours):
    def __str__(self) -> str:
        return "own " + super().__repr__()


@pytest.mark.parametrize("given", [((1,), {}), ((1, (3,)), {"c": "x"}), ((), {"a": 4, "b": ()})])
def test_values_and_texts_are_those_of_the_standard_library(given: tuple[typing.Any, ...]) -> None:
    ours, standard = Ours(*given[0], **given[1]), Standard(*given[0], **given[1])
    assert ours == standard == tuple(ours) and hash(ours) == hash(standard)
    assert repr(ours) == repr(standard).replace("Standard", "Ours")
    assert ours._asdict() == standard._asdict() and (ours.a, ours.b, ours.c) == tuple(standard)
    assert ours._replace(c="y") == standard._replace(c="y")
    assert copy.deepcopy(ours) == pickle.loads(pickle.dumps(ours)) == ours
    assert type(copy.copy(ours)) is Ours and ours.total == Ours.of(ours.a)._replace(b=ours.b).total


@pytest.mark.parametrize(
    "given", [((), {}), ((1, 2, 3, 4), {}), ((1,), {"a": 2}), ((1,), {"d": 2})]
)
def test_wrong_arguments_are_refused_in_the_same_words(given: tuple[typing.Any, ...]) -> None:
    messages = []
    for kind in (Ours, Standard):
        with pytest.raises(TypeError) as caught:
            kind(*given[0], **given[1])
        messages.append(str(caught.value).replace(kind.__name__, ""))
    assert messages[0] == messages[1]


def test_classes_say_what_they_are() -> None:
    for name in ("_fields", "_field_defaults", "__match_args__", "__doc__"):
        assert getattr(Ours, name) == getattr(Standard, name)
    assert typing.get_type_hints(Ours) == typing.get_type_hints(Standard)
    assert list(inspect.signature(Ours).parameters) == list(inspect.signature(Standard).parameters)
    assert str(Derived(1)) == "own Derived(a=1, b=(1, 2), c=None)"
    with pytest.raises(AttributeError):
        Ours(1).a = 2  # type: ignore[misc]
    with pytest.raises(ValueError, match="unexpected field names"):
        Ours(1)._replace(d=2)
    with pytest.raises(TypeError, match="Expected 3 arguments, got 2"):
        Ours._make((1, 2))


def test_a_field_without_default_comes_before_those_with_one() -> None:
    fields = {"__annotations__": {"a": "int", "b": "int"}, "a": 1}
    with pytest.raises(TypeError, match="without default"):
        type(NamedTuple.__mro_entries__(())[0])("Wrong", (), fields)
