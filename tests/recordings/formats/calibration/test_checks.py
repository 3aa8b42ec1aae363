"""Warnings for implausible intrinsics."""

from __future__ import annotations

from pathlib import Path

import pytest
from calibration_files import read


@pytest.mark.parametrize(
    ("intrinsics", "expected"),
    [
        ("[500, 500, -20, 240]", "principal point (-20, 240) is outside the 640x480 image"),
        ("[0.78, 0.79, 0.5, 0.5]", "field of view of 180 degrees; check the unit"),
        ("[20000, 20000, 320, 240]", "field of view of 1.83 degrees"),
        ("[500, 500, 320, 240]", ""),
    ],
)
def test_warning_for_implausible_intrinsics(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, intrinsics: str, expected: str
) -> None:
    read(tmp_path, f"cam0: {{resolution: [640, 480], intrinsics: {intrinsics}}}")
    assert expected in caplog.text
    assert bool(caplog.records) == bool(expected)
