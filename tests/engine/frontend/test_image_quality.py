"""Defects of images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from vo.base.failures import ImageDefect
from vo.base.faults import FaultKind
from vo.base.types import Bytes
from vo.cli.app import app
from vo.engine.frontend.image_faults import (
    ImageFaults,
    blur,
    image_defect,
    noise_level,
    size_faults,
)

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
    assert result.exit_code == 3, result.output
    assert f"no frame was tracked (the image is {told})" in result.stdout
    assert f"warning: images 0 to 3 are {told}\n" in result.stdout
    assert advice in result.stdout


def test_images_with_something_in_them_are_not_to_blame(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for i in range(4):
        assert cv2.imwrite(str(folder / f"{i}.png"), noise(20, 60, i))
    (folder / "calibration.yaml").write_text(CALIBRATION, encoding="utf-8")
    result = CliRunner().invoke(app, ["run", str(folder), "-o", str(tmp_path / "out")])
    assert "no frame was tracked" in result.stdout
    assert "almost" not in result.stdout and "of one grey" not in result.stdout


@pytest.fixture(scope="module")
def scene() -> Bytes:
    """Rectangles and discs of all sizes: sharp, bright, with contrast."""
    rng = np.random.default_rng(3)
    image = np.full((300, 400), 120, np.uint8)
    for _ in range(400):
        x, y, size = (int(v) for v in rng.integers((0, 0, 3), (400, 300, 40)))
        grey = int(rng.integers(0, 256))
        cv2.rectangle(image, (x, y), (x + size, y + size // 2), grey, -1)
    return cv2.GaussianBlur(image, (0, 0), 0.7)


def test_a_good_image_has_no_defect(scene: Bytes) -> None:
    assert image_defect(scene) is None
    assert blur(scene) < 0.4 and noise_level(scene) < 3


def test_each_defect_is_measured(scene: Bytes) -> None:
    rng = np.random.default_rng(4)
    interlaced = scene.copy()
    interlaced[1::2] = np.roll(scene, 12, axis=1)[1::2]
    noisy = np.clip(scene + rng.normal(0, 25, scene.shape), 0, 255).astype(np.uint8)
    for image, defect in (
        (scene[:160, :200], ImageDefect.SMALL),
        (scene // 6, ImageDefect.DARK),
        (200 + scene // 12, ImageDefect.LOW_CONTRAST),
        (interlaced, ImageDefect.INTERLACED),
        (noisy, ImageDefect.NOISY),
        (cv2.GaussianBlur(scene, (0, 0), 8), ImageDefect.BLURRED),
    ):
        assert image_defect(image) is defect
    assert noise_level(noisy) == pytest.approx(25, rel=0.15)


def test_a_recording_that_is_blurred_throughout_is_a_fault(scene: Bytes) -> None:
    detector, blurred = ImageFaults(), cv2.blur(scene, (1, 21))
    for _ in range(100):
        detector.update(scene)
    detector.update(blurred)  # a single one is no fault
    assert detector.faults == ()
    for _ in range(32):
        detector.update(blurred)
    (fault,) = detector.faults
    assert (fault.kind, fault.is_handled) == (FaultKind.BLURRED_IMAGES, False)
    assert fault.value > 0.6


@pytest.mark.parametrize("size", [(160, 100), (224, 140), (306, 92), (429, 130)])
def test_small_images_are_not_to_be_trusted(size: tuple[int, int]) -> None:
    (fault,) = size_faults(size[0] * size[1])
    assert fault.kind is FaultKind.SMALL_IMAGES and not fault.is_handled
    assert fault.value == pytest.approx(1e-3 * size[0] * size[1])


@pytest.mark.parametrize("size", [(320, 200), (320, 240), (640, 400)])
def test_usual_images_are_no_fault(size: tuple[int, int]) -> None:
    assert size_faults(size[0] * size[1]) == ()
