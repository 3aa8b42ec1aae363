"""Conversion of raw pixels to grey, compared with images of known grey levels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.recordings.formats.messages import ImageMessage
from vo.recordings.formats.pixels import grey_pixels

RNG = np.random.default_rng(5)
GREY = RNG.integers(0, 256, (6, 8), dtype=np.uint8)
COLOUR = cv2.GaussianBlur(RNG.integers(0, 256, (40, 60, 3), dtype=np.uint8), (0, 0), 8)
BGR_TO_GREY = np.array([0.114, 0.587, 0.299])


def message(encoding: str, pixels: np.ndarray, **more: object) -> ImageMessage:
    height, width = pixels.shape[:2]
    return ImageMessage(1, "cam0", width, height, encoding, pixels.tobytes(), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "MONO8"])
def test_grey_is_unchanged(encoding: str) -> None:
    assert np.array_equal(grey_pixels(message(encoding, GREY)), GREY)


@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_sixteen_bits_in_either_byte_order(encoding: str, order: str) -> None:
    deep = RNG.integers(0, 65536, (6, 8), dtype=np.uint16)
    stored = deep.astype(f"{order}u2")
    image = grey_pixels(message(encoding, stored, big_endian=order == ">"))
    assert image.dtype == np.uint16
    assert np.array_equal(image, deep)


@pytest.mark.parametrize(
    ("encoding", "order"),
    [
        ("bgr8", [0, 1, 2]),
        ("8UC3", [0, 1, 2]),
        ("rgb8", [2, 1, 0]),
        ("bgra8", [0, 1, 2, 0]),
        ("rgba8", [2, 1, 0, 0]),
        ("bgr16", [0, 1, 2]),
        ("rgb16", [2, 1, 0]),
    ],
)
def test_colour_is_converted_to_grey_by_channel(encoding: str, order: list[int]) -> None:
    pixels = COLOUR[:, :, order]
    if encoding.endswith("16"):
        pixels = pixels.astype(np.uint16)
    grey = grey_pixels(message(encoding, pixels))
    assert np.abs(grey - COLOUR @ BGR_TO_GREY).max() <= 1.0


# The name lists the colours of a 2x2 tile, row by row.
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_patterns_match_their_names(pattern: str, bits: int) -> None:
    levels = {"r": 200, "g": 120, "b": 40}
    tile = np.array([levels[letter] for letter in pattern]).reshape(2, 2)
    mosaic = np.tile(tile, (10, 12)).astype(np.uint8 if bits == 8 else np.uint16)
    grey = grey_pixels(message(f"bayer_{pattern}{bits}", mosaic))
    expected = 0.114 * 40 + 0.587 * 120 + 0.299 * 200
    assert np.abs(grey[2:-2, 2:-2] - expected).max() <= 1.5


@pytest.mark.parametrize(
    ("encoding", "luminance_channel"), [("yuv422", 1), ("uyvy", 1), ("yuv422_yuy2", 0), ("yuyv", 0)]
)
def test_grey_of_yuv_is_its_luminance(encoding: str, luminance_channel: int) -> None:
    pixels = np.full((6, 8, 2), 128, np.uint8)
    pixels[:, :, luminance_channel] = GREY
    assert np.array_equal(grey_pixels(message(encoding, pixels)), GREY)


def test_row_padding_is_skipped() -> None:
    padded = np.zeros((6, 13), np.uint8)
    padded[:, :8] = GREY
    whole = ImageMessage(1, "cam0", 8, 6, "mono8", padded.tobytes(), step=13)
    assert np.array_equal(grey_pixels(whole), GREY)
    # The padding of the last row may be missing.
    cut = ImageMessage(1, "cam0", 8, 6, "mono8", padded.tobytes()[:-5], step=13)
    assert np.array_equal(grey_pixels(cut), GREY)


@pytest.mark.parametrize(
    ("encoding", "width", "step", "reason"),
    [
        ("mono8", 8, 0, "has 47 bytes; 48 are needed"),
        ("mono8", 8, 4, "rows of 4 bytes"),
        ("mono8", 0, 0, "image of 0x6"),
        ("rgb8", 8, 0, "144 are needed"),
        ("jpeg?", 8, 0, "encoding 'jpeg\\?' is not supported; supported are mono8"),
        ("32FC1", 8, 0, "encoding '32FC1' is not supported"),
    ],
)
def test_error_names_the_problem(encoding: str, width: int, step: int, reason: str) -> None:
    data = bytes(47)
    with pytest.raises(SourceError, match=reason):
        grey_pixels(ImageMessage(1, "cam0", width, 6, encoding, data, step=step))
