"""Recordings in which nothing is to be seen."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from vo.cli.app import app
from vo.types import Bytes

SIZE = (120, 160)
CALIBRATION = "cam0: {resolution: [160, 120], intrinsics: [120.0, 120.0, 79.5, 59.5]}\n"


def noise(low: int, high: int, seed: int = 0) -> Bytes:
    return np.random.default_rng(seed).integers(low, high, SIZE, dtype=np.uint8)


def overexposed() -> Bytes:
    image = np.full(SIZE, 255, np.uint8)
    image[:20] = noise(100, 200)[:20]
    return image


@pytest.mark.parametrize(
    ("image", "told", "advice"),
    [
        (np.zeros(SIZE, np.uint8), "almost black", "lens cap"),
        (noise(0, 12), "almost black", "lens cap"),
        (np.full(SIZE, 255, np.uint8), "almost white", "exposure too long?"),
        (overexposed(), "almost white", "exposure too long?"),
        (np.full(SIZE, 128, np.uint8), "of one grey", "is the lens covered"),
    ],
)
def test_says_that_the_images_are_to_blame(
    tmp_path: Path, image: Bytes, told: str, advice: str
) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for i in range(4):
        assert cv2.imwrite(str(folder / f"{i}.png"), image)
    (folder / "calibration.yaml").write_text(CALIBRATION, encoding="utf-8")
    result = CliRunner().invoke(app, ["run", str(folder), "-o", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert f"no frame was tracked (the image is {told})" in result.stdout
    assert f"warning: images 0 to 3 are {told}\n" in result.stdout
    assert advice in result.stdout


def test_images_with_something_in_them_are_not_to_blame(tmp_path: Path) -> None:
    for i in range(4):
        assert cv2.imwrite(str(tmp_path / f"{i}.png"), noise(20, 60, i))
    (tmp_path / "calibration.yaml").write_text(CALIBRATION, encoding="utf-8")
    result = CliRunner().invoke(app, ["run", str(tmp_path), "-o", str(tmp_path / "out")])
    assert "no frame was tracked" in result.stdout
    assert "almost" not in result.stdout and "of one grey" not in result.stdout
