"""Conversion of raw pixels to grey, compared with images of known grey levels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.recordings.formats.messages import ImageMessage
from vo.recordings.formats.pixels import colour_pixels, grey_pixels

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


YUV = cv2.cvtColor(COLOUR, cv2.COLOR_BGR2YUV_I420)
_HALF = (20, 30)
LUMA, U, V = YUV[:40], YUV[40:50].reshape(_HALF), YUV[50:].reshape(_HALF)


def planes(*parts: np.ndarray, step: int = 0) -> bytes:
    """Planes below each other, in rows of 60 pixels, or of `step` bytes."""
    rows = np.concatenate([part.reshape(-1, 60) for part in parts])
    return np.pad(rows, ((0, 0), (0, max(step - 60, 0)))).tobytes()


@pytest.mark.parametrize(
    ("encoding", "parts", "step"),
    [
        ("nv12", (LUMA, np.dstack([U, V])), 0),
        ("NV12", (LUMA, np.dstack([U, V])), 64),
        ("nv21", (LUMA, np.dstack([V, U])), 60),
        ("i420", (LUMA, U, V), 0),
        ("yuv420", (LUMA, U, V), 60),
        ("yv12", (LUMA, V, U), 0),
    ],
)
def test_planes_of_brightness_and_colour(
    encoding: str, parts: tuple[np.ndarray, ...], step: int
) -> None:
    data = planes(*parts, step=step)
    image = ImageMessage(1, "cam0", 60, 40, encoding, data, step)
    assert np.array_equal(grey_pixels(image), LUMA)
    assert np.abs(colour_pixels(image).astype(int) - COLOUR).mean() < 2.0
    with pytest.raises(SourceError, match=r"60x40 .* are needed"):
        grey_pixels(ImageMessage(1, "cam0", 60, 40, encoding, data[: -step - 60], step))


def test_planes_of_whole_colour() -> None:
    data = planes(LUMA, np.zeros((80, 60), np.uint8))
    image = ImageMessage(1, "cam0", 60, 40, "nv24", data)
    assert np.array_equal(grey_pixels(image), LUMA)


def test_planes_with_padded_rows_are_refused() -> None:
    with pytest.raises(SourceError, match="rows of i420 with 64 bytes are not read"):
        grey_pixels(ImageMessage(1, "cam0", 60, 40, "i420", bytes(64 * 60), 64))


@pytest.mark.parametrize(
    ("encoding", "same"),
    [("GREY", "mono8"), ("Y8", "mono8"), ("L_INT8", "mono8"), ("R8G8B8", "rgb8"), ("bgr", "bgr8")],
)
def test_other_names(encoding: str, same: str) -> None:
    pixels = GREY if same == "mono8" else COLOUR
    expected = grey_pixels(message(same, pixels))
    assert np.array_equal(grey_pixels(message(encoding, pixels)), expected)


@pytest.mark.parametrize("encoding", ["mono12", "Y16", "bayer_rggb12"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_other_names_of_sixteen_bits(encoding: str, order: str) -> None:
    deep = (GREY.astype(np.uint16) << 4).astype(f"{order}u2")
    standard = "bayer_rggb16" if "bayer" in encoding else "mono16"
    images = [message(name, deep, big_endian=order == ">") for name in (encoding, standard)]
    assert np.array_equal(*map(grey_pixels, images))
    packed = ImageMessage(1, "cam0", 8, 6, encoding, bytes(8 * 6 * 3 // 2))
    with pytest.raises(SourceError, match="has 72 bytes; 96 are needed"):
        grey_pixels(packed)


@pytest.mark.parametrize("encoding", ["64FC1"])
def test_depth_is_no_image_of_a_camera(encoding: str) -> None:
    with pytest.raises(SourceError, match="is that of depth; choose the topic of a camera"):
        grey_pixels(message(encoding, GREY))


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
        ("32FC1", 8, 0, "encoding '32FC1' is that of depth"),
    ],
)
def test_error_names_the_problem(encoding: str, width: int, step: int, reason: str) -> None:
    data = bytes(47)
    with pytest.raises(SourceError, match=reason):
        grey_pixels(ImageMessage(1, "cam0", width, 6, encoding, data, step=step))
