"""Dictionaries of markers by name, and the choice of the one that images show."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from vo.base.errors import ConfigError
from vo.base.types import Ints

AUTO = "auto"
DEFAULT_TO_PRINT = "APRILTAG_36H11"
STANDARD, _STANDARD_COUNT = "APRILTAG_STANDARD41H12", 2115  # which OpenCV does not have
_SIZES = (50, 100, 250, 1000)  # of the dictionaries of OpenCV that contain each other
# The largest one of each kind; smaller ones are their beginnings. OpenCV's are first.
CANDIDATES = (
    *(f"{n}X{n}_1000" for n in (4, 5, 6, 7)),
    "ARUCO_ORIGINAL",
    "ARUCO_MIP_36H12",
    *(f"APRILTAG_{name}" for name in ("16H5", "25H9", "36H10", "36H11")),
    STANDARD,
)


@lru_cache(maxsize=1)
def known_dictionaries() -> dict[str, int]:
    """Dictionaries by name, such as `4X4_50`, with OpenCV's number, -1 for `STANDARD`."""
    names = [name for name in dir(cv2.aruco) if name.startswith("DICT_") and name.isupper()]
    numbers = {name.removeprefix("DICT_"): int(getattr(cv2.aruco, name)) for name in names}
    return {**numbers, STANDARD: -1}


def dictionary_name(given: str) -> str:
    """The name of a dictionary as it is listed: `tag36h11`, `DICT_4X4_50` and `4x4_50` are known.

    Raises:
        ConfigError: there is no such dictionary.
    """
    name = given.strip().upper().removeprefix("DICT_")
    if name.lower() == AUTO:
        return AUTO
    if name.startswith("TAG"):
        name = "APRILTAG_" + name.removeprefix("TAG")
    if name not in known_dictionaries():
        listed = ", ".join(["auto", *known_dictionaries()])
        raise ConfigError(f"unknown `dictionary` '{given}'; use one of {listed}")
    return name


@lru_cache(maxsize=32)
def dictionary(name: str) -> Any:
    """OpenCV's dictionary of a name from `dictionary_name`."""
    return cv2.aruco.getPredefinedDictionary(known_dictionaries()[name])


def marker_count(name: str) -> int:
    """Number of markers of a dictionary."""
    return _STANDARD_COUNT if name == STANDARD else len(dictionary(name).bytesList)


def is_same_kind(first: str, second: str) -> bool:
    """Whether both dictionaries begin with the same markers, as `4X4_50` and `4X4_1000` do."""
    stems = set()
    for name in (first, second):
        stem, _, size = name.rpartition("_")
        stems.add(stem if size.isdigit() and int(size) in _SIZES else name)
    return len(stems) == 1


def smallest_containing(name: str, ids: Sequence[int] | Ints) -> str:
    """The smallest dictionary that begins like `name` and has all ids: `4X4_50` of `4X4_1000`."""
    stem, _, size = name.rpartition("_")
    if not size.isdigit() or int(size) not in _SIZES:
        return name
    largest = int(np.max(np.asarray(ids, dtype=np.int64), initial=0))
    return f"{stem}_{next(n for n in _SIZES if largest < n)}"
