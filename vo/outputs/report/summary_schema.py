"""What a report reads of `summary.json`, and a check of it."""

from __future__ import annotations

import math
from typing import Any

from vo.base.errors import SourceError

_MAX_NUMBER = 1e15
_TEXT, _WHOLE, _NUMBER, _YES_NO = "a text", "a whole number", "a number", "true or false"
_OPTIONAL = " or null"

# Values: the kind of a value, a list of one kind, or keys with their kinds. A key that ends in `?`
# may be missing.
_SCHEMA: dict[str, Any] = {
    **dict.fromkeys(("source", "format", "mode", "status"), _TEXT),
    **dict.fromkeys(("frames", "tracked", "keyframes", "landmarks"), _WHOLE),
    **dict.fromkeys(("start", "end", "stride", "seed"), _WHOLE),
    **dict.fromkeys(("path_m", "frames_per_s", "wall_s", "peak_rss_mb"), _NUMBER),
    "median_inliers": _NUMBER + _OPTIONAL,
    "error": _TEXT + _OPTIONAL,
    "warnings": [_TEXT],
    "segments": [
        {
            **dict.fromkeys(("segment", "first_frame", "last_frame", "frames"), _WHOLE),
            **dict.fromkeys(("first_stamp_ns", "last_stamp_ns"), _WHOLE),
            "path_m": _NUMBER,
        }
    ],
    "without_pose": [
        {
            **dict.fromkeys(("first", "last", "frames"), _WHOLE),
            **dict.fromkeys(("state", "reason"), _TEXT),
        }
    ],
    "versions": {},
    "interpolated?": _WHOLE,
    "inertial_poses?": _WHOLE,
    "inertial_orientations?": _WHOLE,
    "loops?": [
        {
            **dict.fromkeys(("frame", "earlier_frame", "inliers"), _WHOLE),
            "kind": _TEXT,
            "marker?": _WHOLE,
            **dict.fromkeys(("correction_m", "correction_deg"), _NUMBER + _OPTIONAL),
        }
    ],
    "relocalisations?": [
        {
            **dict.fromkeys(("frame", "segment", "earlier_frame", "loops", "inliers"), _WHOLE),
            **dict.fromkeys(("correction_m", "correction_deg"), _NUMBER),
        }
    ],
    "faults?": [{"is_handled": _YES_NO}],
    "length_unit?": _TEXT,
    "calibration?": _TEXT + _OPTIONAL,
    "topics?": [_TEXT],
    "right_offset_ns?": _WHOLE + _OPTIONAL,
}


def check_summary(where: str, summary: Any) -> None:
    """Check the values that a report reads.

    Args:
        where: the file, for the message.
        summary: content of the file.

    Raises:
        SourceError: a value is missing or of another kind.
    """
    try:
        _check("", summary, _SCHEMA)
    except ValueError as error:
        raise SourceError(f"{where}: {error}; run `vo run` again") from error


def _check(place: str, value: Any, schema: Any) -> None:
    if isinstance(schema, dict):
        if not isinstance(value, dict):
            raise _wrong(place, value, "a group of values")
        for key, kind in schema.items():
            name = key.removesuffix("?")
            inner = f"{place}.{name}" if place else name
            if name in value:
                _check(inner, value[name], kind)
            elif name == key:
                raise ValueError(f"'{inner}' is missing")
    elif isinstance(schema, list):
        if not isinstance(value, list):
            raise _wrong(place, value, "a list")
        for number, item in enumerate(value):
            _check(f"{place}[{number}]", item, schema[0])
    elif not _is(value, schema):
        raise _wrong(place, value, schema)


def _is(value: Any, kind: str) -> bool:
    if value is None:
        return kind.endswith(_OPTIONAL)
    match kind.removesuffix(_OPTIONAL):
        case "a text":
            return isinstance(value, str)
        case "true or false":
            return isinstance(value, bool)
        case "a whole number":
            is_whole = isinstance(value, int) and not isinstance(value, bool)
            return is_whole and -(2**63) <= value < 2**63
        case _:
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            return is_number and math.isfinite(value) and abs(value) <= _MAX_NUMBER


def _wrong(place: str, value: Any, expected: str) -> ValueError:
    return ValueError(f"'{place}' is {' '.join(repr(value)[:80].split())}, not {expected}")
