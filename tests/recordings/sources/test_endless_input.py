"""Devices and pipes instead of files: reading them may never end, or never begin."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from vo.base.errors import CalibrationError, SourceError
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.formats.trajectory import read_trajectory
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.registry import FORMATS, open_source


@pytest.fixture(params=["device", "pipe"])
def endless(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == "device":
        return Path("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def test_error_for_a_trajectory(endless: Path) -> None:
    with pytest.raises(SourceError, match="is a device or a pipe, not a file"):
        read_trajectory(endless)


def test_error_for_a_calibration(endless: Path) -> None:
    with pytest.raises(CalibrationError, match="is a device or a pipe, not a file"):
        read_calibration(endless)


@pytest.mark.parametrize("format", [None, *FORMATS])
def test_error_for_a_recording(endless: Path, format: str | None) -> None:
    with pytest.raises(SourceError, match="is neither a file nor a folder"):
        open_source(endless, format=format)


def test_error_for_an_image(endless: Path) -> None:
    with pytest.raises(SourceError, match="is a device or a pipe, not a file"):
        ImageFile(endless).read()
