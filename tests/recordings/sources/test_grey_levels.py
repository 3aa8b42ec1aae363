"""16-bit images: those that use little of their range are stretched, all others only shifted."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import layouts
import mcap_logs
import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.base.types import Bytes
from vo.recordings.formats.messages import ImageMessage, Message
from vo.recordings.sources.grey_levels import GreyLevels, difference, find_grey_levels
from vo.recordings.sources.images import Pixels
from vo.recordings.sources.registry import open_source

SCENE = np.random.default_rng(0).random((40, 60))


@dataclass(frozen=True, eq=False)
class Image:
    """A `StoredImage` in memory; None is unreadable."""

    pixels: Pixels | None
    name: str = "in memory"

    def read(self, colour: bool = False) -> Pixels:
        if self.pixels is None:
            raise SourceError("damaged")
        return self.pixels


def scene(low: float, counts: float) -> Image:
    return Image((low + counts * SCENE).astype(np.uint16))


def bits(levels: GreyLevels, image: Image, frame: int = 0) -> Bytes:
    assert image.pixels is not None
    return levels.to_8_bits(image.pixels, frame)


@pytest.mark.parametrize("counts", [300, 500, 2000])
def test_images_of_a_thermal_camera_use_all_grey_levels(counts: float) -> None:
    images = [scene(8400, counts)] * 50
    levels = find_grey_levels(images)
    grey = bits(levels, images[0])
    assert levels.bit_depth == 14
    assert np.ptp(np.percentile(grey, (1, 99))) > 190
    assert (grey == 0).mean() + (grey == 255).mean() < 0.02


@pytest.mark.parametrize(("low", "counts"), [(0, 16383), (2000, 6000), (0, 1023), (7000, 60000)])
def test_images_that_use_their_range_keep_their_bits(low: float, counts: float) -> None:
    images = [scene(low, min(counts, 65535 - low))] * 50
    levels = find_grey_levels(images)
    assert levels.stretch is None
    assert images[0].pixels is not None
    np.testing.assert_array_equal(
        bits(levels, images[0]), images[0].pixels >> (levels.bit_depth - 8)
    )


def test_a_bright_scene_among_dark_ones_keeps_all_of_them() -> None:
    images = [scene(0, 300)] * 40 + [scene(0, 4000)] * 10
    assert find_grey_levels(images).stretch is None


def test_hot_pixels_and_unreadable_or_flat_images_do_not_count() -> None:
    clean = find_grey_levels([scene(7400, 500)] * 99)
    images = [scene(7400, 500) for _ in range(99)]
    for image in images[::3]:
        assert image.pixels is not None
        image.pixels[3, 4] = 16383  # of 2,400
    images[96] = Image(None)
    images[48] = Image(np.full((40, 60), 7600, np.uint16))  # a closed shutter
    found = find_grey_levels(images)
    assert clean.stretch is not None
    assert found.stretch is not None
    for frame in (0, 47, 48, 98):
        difference = found.stretch.table(frame).astype(int) - clean.stretch.table(frame)
        assert np.abs(difference).max() <= 2


def test_the_stretch_changes_slowly() -> None:
    """A camera that warms up by 3,000 counts: the same scene keeps its grey levels."""
    images = [scene(7000 + 6 * i, 500) for i in range(500)]
    levels = find_grey_levels(images)
    grey = np.array([bits(levels, image, i).mean() for i, image in enumerate(images)])
    assert np.ptp(grey) < 12
    assert np.abs(np.diff(grey)).max() < 1.5


def test_noise_of_a_covered_sensor_is_not_amplified() -> None:
    noise = np.random.default_rng(1).normal(7400, 3, (40, 60)).astype(np.uint16)
    image = Image(noise)
    assert bits(find_grey_levels([image] * 9), image).std() < 5


def write_pairs(folder: Path, right_offset: int = 0) -> Path:
    for i in range(layouts.COUNT):
        for side, offset in (("left", 0), ("right", right_offset)):
            (folder / side).mkdir(parents=True, exist_ok=True)
            pixels = (7400 + 40 * i + offset + 500 * SCENE).astype(np.uint16)
            cv2.imwrite(str(folder / side / f"{i:03d}.png"), np.ascontiguousarray(pixels))
    text = layouts.CALIBRATION.replace(f"[{layouts.WIDTH}, {layouts.HEIGHT}]", "[60, 40]")
    layouts.write_text(folder / "calibration.yaml", text)
    layouts.write_text(
        folder / "times.txt", "".join(f"{0.1 * i:.1f}\n" for i in range(layouts.COUNT))
    )
    return folder


def test_left_and_right_and_any_start_have_the_same_stretch(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    source = open_source(write_pairs(tmp_path / "pairs"))
    assert caplog.text.count("contrast is stretched to 8 bits") == 1
    whole = {frame.index: frame for frame in source.frames()}
    for frame in whole.values():
        assert frame.image1 is not None
        assert np.array_equal(frame.image0, frame.image1)
        assert np.ptp(frame.image0) > 150
    last = list(source.frames(2, None, 2))
    assert [frame.index for frame in last] == list(range(2, layouts.COUNT, 2))
    for frame in last:
        assert np.array_equal(frame.image0, whole[frame.index].image0)
    recorded = next(iter(source.frames(images="recorded"))).image0
    assert recorded.dtype == np.uint16


def test_the_range_is_that_of_both_cameras(tmp_path: Path) -> None:
    frames = list(open_source(write_pairs(tmp_path / "pairs", right_offset=300)).frames())
    for frame in frames:
        assert frame.image1 is not None
        for image in frame.images:
            assert image is not None
            assert (image == 255).mean() + (image == 0).mean() < 0.02


@pytest.mark.parametrize("shift", [0, 4, 8])
def test_exchanged_bytes_are_noticed(shift: int) -> None:
    """Also of 12 bits in the upper ones; right ones stay as they are."""
    smooth = cv2.GaussianBlur(np.random.default_rng(1).random((60, 80)), (0, 0), 3.0)
    levels = (smooth - smooth.min()) / np.ptp(smooth) * ((1 << 16 - shift) - 1)
    image = levels.astype(np.uint16) << shift
    assert not find_grey_levels([Image(image)] * 5).are_swapped
    if shift == 8:  # a lower byte of zeros is as smooth either way
        return
    swapped = Image(image.byteswap())
    found = find_grey_levels([swapped] * 5)
    assert found.are_swapped
    np.testing.assert_array_equal(bits(found, swapped), bits(GreyLevels(16), Image(image)))


def test_noise_is_not_taken_for_exchanged_bytes() -> None:
    noise = np.random.default_rng(2).integers(0, 2**16, (60, 80), np.uint16)
    assert not find_grey_levels([Image(noise)] * 5).are_swapped


def mosaic(colour: Bytes, pattern: str, gains: tuple[float, float, float]) -> Bytes:
    """The raw pixels (H, W) of a sensor with filters in this pattern, of (H, W, 3) RGB."""
    raw = np.empty(colour.shape[:2], np.uint8)
    for place, name in enumerate(pattern):
        channel = "rgb".index(name)
        rows, columns = slice(place // 2, None, 2), slice(place % 2, None, 2)
        raw[rows, columns] = colour[rows, columns, channel] * gains[channel]
    return raw


@pytest.mark.parametrize("bits_used", [8, 16])
@pytest.mark.parametrize("gains", [(0.6, 1.0, 0.5), (1.0, 1.0, 1.0)])  # raw; with white balance
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_mosaics_of_colour_filters_are_averaged(
    pattern: str, gains: tuple[float, float, float], bits_used: int
) -> None:
    rng = np.random.default_rng(3)
    colour = cv2.GaussianBlur(rng.random((60, 80, 3)), (0, 0), 3.0)
    colour = np.asarray((colour - colour.min()) / np.ptp(colour) * 255, np.uint8)
    raw: Pixels = mosaic(colour, pattern, gains)
    if bits_used == 16:
        raw = raw.astype(np.uint16) * np.uint16(257)
    found = find_grey_levels([Image(raw)] * 5)
    assert found.is_mosaic
    expected = colour @ (np.array(gains) * (0.25, 0.5, 0.25))
    error = bits(found, Image(raw))[2:-2, 2:-2] - expected[2:-2, 2:-2]
    assert np.abs(error).max() < 4.0


@pytest.mark.parametrize("sigma", [0.0, 0.5, 1.0, 3.0])
def test_noise_and_edges_are_no_mosaic(sigma: float) -> None:
    rng = np.random.default_rng(4)
    image = rng.integers(0, 256, (60, 80), np.uint8)
    image[20:40, 20:40] = 255  # edges
    image[::7] = 0
    image = cv2.GaussianBlur(image, (0, 0), sigma) if sigma else image
    assert not find_grey_levels([Image(np.asarray(image))] * 5).is_mosaic


def test_a_mosaic_in_mono8_messages_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The grey image is not the mosaic, and raw pixels are as recorded."""
    smooth = np.repeat(cv2.GaussianBlur(layouts.image(0), (0, 0), 2)[:, :, None], 3, axis=2)
    raw = mosaic(np.asarray(smooth), "gbrg", (0.6, 1.0, 0.5))

    def messages() -> Iterator[tuple[str, Message]]:
        for topic, message in layouts.log_messages():
            is_image = isinstance(message, ImageMessage)
            yield topic, replace(message, data=raw.tobytes()) if is_image else message

    source = open_source(mcap_logs.write_log(tmp_path / "log.mcap", messages()))
    assert "colour filters (a Bayer mosaic, not grey as stated)" in caplog.text
    for image in next(iter(source.frames())).images:
        assert image is not None
        assert difference(image) < difference(image, 2)
    recorded = next(iter(source.frames(images="recorded"))).image0
    np.testing.assert_array_equal(recorded, raw)
