from __future__ import annotations

from pathlib import Path

import pytest
from run_calls import CALIBRATION, write_noise


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """Five noise images of one camera, with calibration and stamps."""
    folder = tmp_path / "images"
    for i in range(5):
        write_noise(folder / f"{i}.png", i)
    (folder / "calibration.yaml").write_text(CALIBRATION.format(fx=80.0), encoding="utf-8")
    stamps = "".join(f"{i / 10}\n" for i in range(5))
    (folder / "times.txt").write_text(stamps, encoding="utf-8")
    return folder


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"
