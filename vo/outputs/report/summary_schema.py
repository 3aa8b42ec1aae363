"""Check of what a report reads of `summary.json`."""

from __future__ import annotations

from collections.abc import Container, Mapping
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from vo.base.errors import SourceError
from vo.base.faults import FaultKind
from vo.outputs.results.summary import LEFT_OUT, RunFacts, Summary

_MAX_NUMBER = 1e15
_NAMES: dict[Any, str] = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    tuple: "a list",
}
_REQUIRED = (
    *("source", "format", "mode", "status", "frames", "tracked", "keyframes", "landmarks"),
    *("start", "end", "stride", "seed", "path_m", "frames_per_s", "wall_s", "peak_rss_mb"),
    *("median_inliers", "error", "warnings", "segments", "without_pose", "versions"),
)
# Older runs do not have all of these.
_OPTIONAL = (
    *("interpolated", "inertial_poses", "inertial_orientations", "loops", "relocalisations"),
    *("faults", "length_unit", "calibration", "topics", "right_offset_ns"),
)


def check_summary(where: str, summary: Any) -> None:
    """Check the values that a report reads; `where` is the file.

    Raises:
        SourceError: a value is missing or of another kind.
    """
    of_properties = {"frames_per_s": float, "length_unit": str, "warnings": tuple[str, ...]}
    kinds = {**get_type_hints(Summary), **get_type_hints(RunFacts), **of_properties}
    try:
        _check_group("", summary, {name: kinds[name] for name in _REQUIRED + _OPTIONAL}, _OPTIONAL)
    except ValueError as error:
        raise SourceError(f"{where}: {error}; run `vo run` again") from error


def _check_group(
    place: str, value: Any, kinds: Mapping[str, Any], optional: Container[str]
) -> None:
    if not isinstance(value, dict):
        raise _wrong(place, value, "a group of values")
    for name, kind in kinds.items():
        inner = f"{place}.{name}" if place else name
        if name in value:
            _check(inner, value[name], kind)
        elif name not in optional:
            raise ValueError(f"'{inner}' is missing")


def _check(place: str, value: Any, kind: Any) -> None:
    """Raise ValueError if a value is not of the type that a record has for it."""
    is_optional = isinstance(kind, UnionType)
    if is_optional and value is None:
        return
    full = get_args(kind)[0] if is_optional else kind
    basic = get_origin(full) or full
    if basic in (Literal, FaultKind):
        basic = str
    if basic is Mapping:
        _check_group(place, value, {}, ())
    elif basic not in _NAMES:
        kinds = {name: each for name, each in get_type_hints(full).items() if name not in LEFT_OUT}
        _check_group(place, value, kinds, getattr(full, "_field_defaults", vars(full)))
    elif not _is(value, basic):
        raise _wrong(place, value, _NAMES[basic] + " or null" * is_optional)
    elif basic is tuple:
        for number, item in enumerate(value):
            _check(f"{place}[{number}]", item, get_args(full)[0])


def _is(value: Any, kind: type) -> bool:
    if kind is tuple:
        return isinstance(value, list)
    if kind in (str, bool) or isinstance(value, bool):
        return type(value) is kind
    if kind is int:
        return isinstance(value, int) and -(2**63) <= value < 2**63
    return isinstance(value, int | float) and abs(value) <= _MAX_NUMBER  # not NaN


def _wrong(place: str, value: Any, expected: str) -> ValueError:
    return ValueError(f"'{place}' is {' '.join(repr(value)[:80].split())}, not {expected}")
