"""A calibration file as text and as sections with values, and what is read from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vo.errors import CalibrationError
from vo.formats.calibration.markup import sections_of
from vo.types import Floats, Rig

ImageSize = tuple[int, int]

_LARGEST_BYTES = 500_000
"""Reading YAML takes about 7 s a megabyte; calibrations with all their board corners have 0.1."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration file says.

    Attributes:
        rig: the cameras.
        body_from_cam0: (4, 4) where cam0 sits in the frame whose poses the recording's ground
            truth gives, or None where the file does not say.
        depth_per_metre: units of a depth image that are a metre, or None where it does not say.
        kind: the name of the kind of file, a key of `FORMATS`.
        file: where it was read, for messages; None where it is no file of its own.
    """

    rig: Rig
    body_from_cam0: Floats | None = None
    depth_per_metre: float | None = None
    kind: str = ""
    file: Path | None = None


@dataclass(frozen=True)
class Document:
    """A calibration file before anyone has understood it.

    Attributes:
        path: where it is, for messages and for files beside it.
        text: its content.
        data: the content as YAML, JSON or XML; empty where it is no mapping.
        problem: why it is none of them; empty where it is.
    """

    path: Path
    text: str
    data: Mapping[str, Any]
    problem: str = ""

    def section(self, name: str) -> Mapping[str, Any]:
        """The mapping under a top-level key.

        Raises:
            CalibrationError: there is none.
        """
        return as_section(f"{self.path}: {name}", self.data.get(name))


def as_section(where: str, value: Any) -> Mapping[str, Any]:
    """A value that must be a mapping.

    Raises:
        CalibrationError: it is something else.
    """
    if not isinstance(value, Mapping):
        raise CalibrationError(
            f"{where} is {shortened(value)}, not a section; see docs/calibration.md"
        )
    return value


def shortened(value: Any) -> str:
    """A value as it is shown in a message of one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else text[:77] + "..."


def load_document(path: Path) -> Document:
    """Read a calibration file without judging which kind it is.

    Raises:
        CalibrationError: it is missing, far too large or not text.
    """
    try:
        if path.exists() and not path.is_file() and not path.is_dir():  # it may have no end
            raise CalibrationError(f"calibration {path} is no file but a device or a pipe")
        if path.is_file() and path.stat().st_size > _LARGEST_BYTES:
            raise CalibrationError(
                f"calibration file {path} has {path.stat().st_size} bytes; give a text file with "
                f"the cameras alone, below {_LARGEST_BYTES}"
            )
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise CalibrationError(f"calibration file {path} does not exist") from error
    except UnicodeDecodeError as error:
        raise CalibrationError(f"calibration file {path} is not text") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise CalibrationError(f"calibration file {path} cannot be read: {reason}") from error
    data, problem = sections_of(text)
    return Document(path, text, data, problem)
