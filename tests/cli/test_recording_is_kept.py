"""Commands never overwrite the recording that they read."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from vo.cli.app import app

CALIBRATION = "cam0: {resolution: [96, 64], intrinsics: [80.0, 80.0, 47.5, 31.5]}\n"


@pytest.fixture
def images(tmp_path: Path) -> Path:
    folder = tmp_path / "images"
    folder.mkdir()
    for i in range(4):
        noise = np.random.default_rng(i).integers(0, 256, (64, 96), dtype=np.uint8)
        assert cv2.imwrite(str(folder / f"{i}.png"), noise)
    (folder / "calibration.yaml").write_text(CALIBRATION, encoding="utf-8")
    return folder


def assert_refused(path: Path, *words: str | Path) -> None:
    before = path.read_bytes()
    result = CliRunner().invoke(app, list(map(str, words)))
    assert result.exit_code == 1
    assert "is an input and would be replaced; choose another file" in result.stderr
    assert result.stderr.count("\n") == 1
    assert path.read_bytes() == before


def test_a_contact_sheet_does_not_overwrite_the_recording(images: Path, tmp_path: Path) -> None:
    assert_refused(images / "0.png", "info", images, "--picture", images / "0.png")
    sheet = tmp_path / "sheet.png"
    for _ in range(2):
        result = CliRunner().invoke(app, ["info", str(images), "--picture", str(sheet)])
        assert result.exit_code == 0, result.output


def test_a_conversion_does_not_overwrite_the_recording(images: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    made = CliRunner().invoke(app, ["convert", str(images), str(log)])
    assert made.exit_code == 0, made.output
    assert_refused(log, "convert", log, log, "--force", "--end", "2")
    target = images / "calibration.yaml"
    assert_refused(target, "convert", images, target, "--to", "mcap", "--force")
