"""Masks as image editors and other programs write them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.base.errors import ConfigError
from vo.base.types import Bools
from vo.engine.frontend.mask_image import read_mask

SHAPE = (48, 64)


@pytest.fixture
def used() -> Bools:
    mask = np.ones(SHAPE, bool)
    mask[30:] = False
    mask[:6, 10:40] = False
    return mask


def _write(path: Path, pixels: np.ndarray, *options: int) -> Path:
    assert cv2.imwrite(str(path), pixels, list(options))
    return path


@pytest.mark.parametrize("suffix", ["png", "bmp", "pgm", "tif", "webp"])
def test_nonzero_is_used_in_grey(suffix: str, used: Bools, tmp_path: Path) -> None:
    options = (cv2.IMWRITE_WEBP_QUALITY, 101) if suffix == "webp" else ()  # lossless
    path = _write(tmp_path / f"m.{suffix}", used.astype(np.uint8) * 255, *options)
    np.testing.assert_array_equal(read_mask(path), used)


@pytest.mark.parametrize("value", [1, 2, 128, 255])
def test_any_value_above_zero_is_used(value: int, used: Bools, tmp_path: Path) -> None:
    path = _write(tmp_path / "m.png", used.astype(np.uint8) * value)
    np.testing.assert_array_equal(read_mask(path), used)


def test_16_bits_are_not_cut_to_8(used: Bools, tmp_path: Path) -> None:
    path = _write(tmp_path / "m.png", used.astype(np.uint16))
    np.testing.assert_array_equal(read_mask(path), used)


def test_one_bit_per_pixel(used: Bools, tmp_path: Path) -> None:
    path = _write(tmp_path / "m.png", used.astype(np.uint8) * 255, cv2.IMWRITE_PNG_BILEVEL, 1)
    np.testing.assert_array_equal(read_mask(path), used)


def test_a_dark_blue_is_not_black(used: Bools, tmp_path: Path) -> None:
    pixels = np.zeros((*SHAPE, 3), np.uint8)
    pixels[used] = (1, 0, 0)  # 0 as grey
    np.testing.assert_array_equal(read_mask(_write(tmp_path / "m.png", pixels)), used)


def test_what_was_erased_to_transparency_is_not_used(used: Bools, tmp_path: Path) -> None:
    pixels = np.full((*SHAPE, 4), 255, np.uint8)
    pixels[~used, 3] = 0
    np.testing.assert_array_equal(read_mask(_write(tmp_path / "m.png", pixels)), used)


def test_black_stays_black_in_an_opaque_image(used: Bools, tmp_path: Path) -> None:
    pixels = np.full((*SHAPE, 4), 255, np.uint8)
    pixels[~used, :3] = 0
    np.testing.assert_array_equal(read_mask(_write(tmp_path / "m.png", pixels)), used)


def test_the_noise_of_jpeg_is_not_used(used: Bools, tmp_path: Path) -> None:
    path = _write(tmp_path / "m.jpg", used.astype(np.uint8) * 255, cv2.IMWRITE_JPEG_QUALITY, 50)
    decoded = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert decoded is not None and np.count_nonzero(decoded[~used])
    assert np.count_nonzero(read_mask(path) != used) < 0.01 * used.size


@pytest.mark.parametrize("colour", [1, 3, 4])
def test_black_alone_is_refused(colour: int, tmp_path: Path) -> None:
    path = _write(tmp_path / "m.png", np.zeros((*SHAPE, colour), np.uint8))
    with pytest.raises(ConfigError, match=r"m.png is 0 everywhere and leaves nothing: black \(0\)"):
        read_mask(path)


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("0 0 1 1", encoding="utf-8")
    (tmp_path / "empty.png").touch()
    whole = _write(tmp_path / "m.png", np.full(SHAPE, 255, np.uint8)).read_bytes()
    (tmp_path / "half.png").write_bytes(whole[: len(whole) // 2])
    for name, complaint in (
        ("text.png", "text.png is no image"),
        ("empty.png", "empty.png is no image"),
        ("half.png", "cut off or damaged"),
        ("none.png", "none.png cannot be read: No such file"),
        (".", "cannot be read: Is a directory"),
    ):
        with pytest.raises(ConfigError, match=complaint) as error:
            read_mask(tmp_path / name)
        assert "\n" not in str(error.value)
