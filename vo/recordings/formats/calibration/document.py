"""Records: a calibration file as text and sections, and the calibration read from it."""

from __future__ import annotations

import io
import lzma
import math
import zipfile
import zlib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.lib import format as npy

from vo.base.errors import CalibrationError
from vo.base.files.bounded_files import read_bytes, read_text
from vo.base.frozen import frozen
from vo.base.types import Floats, ImuNoise, Rig
from vo.recordings.formats.calibration.markup import MAX_YAML_BYTES, sections_of

ImageSize = tuple[int, int]

_MAX_LARGE_BYTES = 16 * 2**20
"""Of archives, and of JSON, which is fast; NeRF's transforms.json with 10,000 poses has 10 MB."""

_MAX_MEMBER_BYTES = 2**20
_MAX_VALUES = 64
"""Larger arrays, such as the poses of all boards, are no part of a calibration."""

_NO_ARRAY = (
    *(ValueError, OSError, EOFError, OverflowError, TypeError, SyntaxError, TokenError),
    *(RecursionError, MemoryError),
)
"""What numpy raises for an object, a header that is none, or brackets without end."""


@frozen(eq=False)
class ImuCalibration:
    """What a calibration file contains about the inertial sensor.

    Attributes:
        cam0_from_imu: (4, 4) pose of the sensor relative to cam0; None if unknown.
        noise: its noise; None if unknown.
        time_offset_s: what to add to the stamp of an image to get the same moment on the clock of
            the sensor, seconds (Kalibr's `timeshift_cam_imu`); 0 if unknown.
    """

    cam0_from_imu: Floats | None = None
    noise: ImuNoise | None = None
    time_offset_s: float = 0.0


@frozen(eq=False)
class Calibration:
    """Content of a calibration file.

    Attributes:
        body_from_cam0: (4, 4) pose of cam0 in the body frame, whose poses the ground truth of the
            recording contains; None if unknown.
        depth_per_metre: units of a depth image per metre, None if unknown.
        kind: name of the file format, a key of `FORMATS`.
        file: the file, for error messages; None if it was not read from a calibration file.
    """

    rig: Rig
    body_from_cam0: Floats | None = None
    depth_per_metre: float | None = None
    imu: ImuCalibration = ImuCalibration()
    kind: str = ""
    file: Path | None = None


@frozen()
class Document:
    """A calibration file of a format not yet detected.

    Attributes:
        content: its sections, where they are not read from the text, and what is wrong with them.
    """

    path: Path
    text: str
    content: tuple[Mapping[str, Any], str] | None = None

    @cached_property
    def _sections(self) -> tuple[Mapping[str, Any], str]:
        return self.content or sections_of(self.text)

    @property
    def data(self) -> Mapping[str, Any]:
        """The content parsed as YAML, JSON or XML; empty if it is not a mapping."""
        return self._sections[0]

    @property
    def problem(self) -> str:
        """Why it could not be parsed; empty if it could."""
        return self._sections[1]

    def section(self, name: str) -> Mapping[str, Any]:
        """The mapping under a top-level key."""
        return as_section(f"{self.path}: {name}", self.data.get(name))


def as_section(where: str, value: Any) -> Mapping[str, Any]:
    """The value, checked to be a mapping."""
    if not isinstance(value, Mapping):
        raise CalibrationError(
            f"{where} is {shortened(value)}, not a section; see docs/calibration.md"
        )
    return value


def shortened(value: Any) -> str:
    """Representation of a value for an error message, on one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else text[:77] + "..."


def load_document(path: Path) -> Document:
    """Read a calibration file of any format as text and sections."""
    try:
        is_json = path.suffix.lower() == ".json"
        is_npz = path.suffix.lower() == ".npz"
        max_bytes = _MAX_LARGE_BYTES if is_json or is_npz else MAX_YAML_BYTES
        if path.is_file() and path.stat().st_size > max_bytes:
            raise CalibrationError(
                f"calibration file {path} has {path.stat().st_size} bytes; give a text file with "
                f"only the cameras, below {max_bytes} bytes"
            )
        if is_npz:
            return Document(path, "", _read_archive(read_bytes(path, max_bytes)))
        text = read_text(path, max_bytes)
    except FileNotFoundError as error:
        raise CalibrationError(f"calibration file {path} does not exist") from error
    except UnicodeDecodeError as error:
        raise CalibrationError(f"calibration file {path} is not text") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise CalibrationError(f"calibration file {path} cannot be read: {reason}") from error
    return Document(path, text)


def _read_archive(content: bytes) -> tuple[dict[str, Any], str]:
    """Small arrays of a numpy archive by their names, and what is wrong if none is found.

    Scripts save the results of OpenCV's calibration as such. Pickled objects are not loaded, as
    they could run code.
    """
    values: dict[str, Any] = {}
    names = []
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for member in archive.infolist():
                name = member.filename.removesuffix(".npy")
                names.append(name)
                if member.file_size <= _MAX_MEMBER_BYTES:
                    values |= _read_array(name, archive.read(member))
    except (
        *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError),
        *(ValueError, NotImplementedError, RuntimeError),
    ) as error:
        return {}, f"is a damaged numpy archive: {error}"
    listed = ", ".join(names[:8]) or "nothing"
    return values, f"is a numpy archive without a camera matrix (mtx, K, cameraMatrix): {listed}"


def _read_array(name: str, data: bytes) -> dict[str, Any]:
    """The array of a member, if it is small and made of numbers or text.

    Numpy reserves the memory that the header states, so that it is read first.
    """
    stream = io.BytesIO(data)
    try:
        is_first = npy.read_magic(stream) == (1, 0)
        read_header = npy.read_array_header_1_0 if is_first else npy.read_array_header_2_0
        shape, _, dtype = read_header(stream)
        if not math.prod(shape) * dtype.itemsize <= len(data) - stream.tell():
            return {}
        if not 0 <= math.prod(shape) <= _MAX_VALUES or dtype.kind in "cMmVO":
            return {}
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except _NO_ARRAY:
        return {}
    return {name: array.tolist()}
