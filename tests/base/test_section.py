"""Sections behave as the models of pydantic that validate them, which the defaults do not load."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from typing import Literal

import pytest
import yaml

from vo.base.section import Section, expert, setting
from vo.base.settings import as_yaml


def _upper(text: str) -> str:
    if not text:
        raise ValueError("empty")
    return text.upper()


class Inner(Section):
    """Inner settings."""

    size: int = setting(3, ge=1, description="a size")
    name: str = setting("a", after=_upper)


class Outer(Section):
    """Outer settings."""

    words: tuple[str, ...] = setting((), before=lambda given: given.split("+"))
    kind: Literal["x", "y"] | None = expert(None)
    inner: Inner = Inner()


def test_values_are_validated_and_converted() -> None:
    given = Outer.model_validate({"words": "a+b", "inner": {"size": "7", "name": "b"}})
    assert given == Outer(words="a+b", inner=Inner(size=7, name="b"))
    assert given.model_dump() == {
        **{"words": ("a", "b"), "kind": None},
        "inner": {"size": 7, "name": "B"},
    }
    assert repr(given.inner) == "Inner(size=7, name='B')"
    assert given != Outer() and hash(Outer()) == hash(Outer(kind=None))


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"inner": {"size": 0}}, "greater than or equal to 1"),
        ({"inner": {"siez": 1}}, "Extra inputs are not permitted"),
        ({"inner": Outer()}, "Inner"),
        ({"inner": {"name": ""}}, "empty"),
        ({"kind": "z"}, "'x' or 'y'"),
        ({1: 2}, "string|Extra"),
    ],
)
def test_wrong_values_are_refused(values: dict[str, object], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Outer.model_validate(values)


def test_copies_have_other_values_and_a_section_cannot_be_changed() -> None:
    given = Outer(kind="x")
    assert given.model_copy(update={"kind": "y"}) == Outer(kind="y")
    assert given.model_copy() == copy.deepcopy(given) == pickle.loads(pickle.dumps(given)) == given
    with pytest.raises(ValueError, match="frozen"):
        given.kind = "y"
    with pytest.raises(ValueError, match="frozen"):
        del given.kind


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"words": "yes+a"},
        {"words": "1"},
        {"inner": {"name": "ÄB: c"}},
        {"inner": {"name": "no"}},
    ],
)
def test_yaml_is_what_pyyaml_writes(values: dict[str, object]) -> None:
    given = Outer.model_validate(values)
    assert as_yaml(given) == yaml.safe_dump(given.model_dump(mode="json"), sort_keys=False)


def test_the_defaults_are_loaded_and_written_without_pydantic_and_yaml() -> None:
    program = (
        "import sys; from vo.base.config import *; dump_config(load_config());"
        "sys.exit(bool({'pydantic', 'yaml'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
