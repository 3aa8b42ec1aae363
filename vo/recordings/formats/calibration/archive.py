"""Reader of numpy archives (`.npz`), in which scripts save the results of OpenCV's calibration."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

_MAX_MEMBER_BYTES = 2**20
_MAX_VALUES = 64
"""Larger arrays, such as the poses of all boards, are no part of a calibration."""


def is_npz(path: Path) -> bool:
    """Whether a file is a numpy archive, by its name."""
    return path.suffix.lower() == ".npz"


def read_archive(content: bytes) -> tuple[dict[str, Any], str]:
    """Small arrays by their names as numbers and nested lists, and what is wrong if none is found.

    Pickled objects are not loaded, as they could run code.
    """
    values: dict[str, Any] = {}
    names = []
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for member in archive.infolist():
                name = member.filename.removesuffix(".npy")
                names.append(name)
                if member.file_size <= _MAX_MEMBER_BYTES:
                    values |= _read(name, archive.read(member))
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, RuntimeError) as error:
        return {}, f"is a damaged numpy archive: {error}"
    listed = ", ".join(names[:8]) or "nothing"
    return values, f"is a numpy archive without a camera matrix (mtx, K, cameraMatrix): {listed}"


def _read(name: str, data: bytes) -> dict[str, Any]:
    """The array of a member, if it is small and made of numbers or text."""
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError):  # an object, or not an array
        return {}
    if not isinstance(array, np.ndarray) or array.size > _MAX_VALUES or array.dtype.kind in "cMmV":
        return {}
    return {name: array.tolist()}
