"""A calibration file as text and parsed YAML, and what is read from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from vo.errors import CalibrationError
from vo.types import Floats, Rig

ImageSize = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration file says.

    Attributes:
        rig: the cameras.
        body_from_cam0: (4, 4) where cam0 sits in the frame whose poses the recording's ground
            truth gives, or None where the file does not say.
        depth_per_metre: units of a depth image that are a metre, or None where it does not say.
    """

    rig: Rig
    body_from_cam0: Floats | None = None
    depth_per_metre: float | None = None


@dataclass(frozen=True)
class Document:
    """A calibration file before anyone has understood it.

    Attributes:
        path: where it is, for messages and for files beside it.
        text: its content.
        data: the content as YAML; empty where it is not a YAML mapping.
    """

    path: Path
    text: str
    data: Mapping[str, Any]

    def section(self, name: str) -> Mapping[str, Any]:
        """The mapping under a top-level key.

        Raises:
            CalibrationError: there is none.
        """
        value = self.data.get(name)
        if not isinstance(value, Mapping):
            raise CalibrationError(
                f"{self.path}: {name} is {value!r}, not a section; see docs/calibration.md"
            )
        return value


def load_document(path: Path) -> Document:
    """Read a calibration file without judging which kind it is.

    Raises:
        CalibrationError: it is missing, not text, or neither YAML nor lines of `name: numbers`.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise CalibrationError(f"calibration file {path} does not exist") from error
    except UnicodeDecodeError as error:
        raise CalibrationError(f"calibration file {path} is not text") from error
    except OSError as error:
        raise CalibrationError(
            f"calibration file {path} cannot be read: {error.strerror or error}"
        ) from error
    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise CalibrationError(f"calibration file {path} is not YAML: {reason}") from error
    return Document(path, text, data if isinstance(data, Mapping) else {})
