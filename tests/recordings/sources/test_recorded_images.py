"""Images as recorded, in colour and with 16 bits; those for the odometry stay grey."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import layouts
import mcap_logs
import numpy as np
import pytest

from vo.base.types import Camera
from vo.recordings.formats.messages import (
    CalibrationMessage,
    CompressedImageMessage,
    ImageMessage,
    Message,
)
from vo.recordings.sources.images import Pixels
from vo.recordings.sources.registry import open_source

WIDTH, HEIGHT = layouts.WIDTH, layouts.HEIGHT
_noise = np.random.default_rng(11)
COLOUR = _noise.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
DEEP = _noise.integers(0, 4096, (HEIGHT, WIDTH), dtype=np.uint16)
DEEP_COLOUR = _noise.integers(0, 65536, (HEIGHT, WIDTH, 3), dtype=np.uint16)


def folder_of(path: Path, image: Pixels, suffix: str = ".png") -> Path:
    layouts.write_image(path / f"0{suffix}", image)  # type: ignore[arg-type]
    layouts.write_text(path / "calibration.yaml", layouts.CALIBRATION)
    return path


def log_of(path: Path, message: Message) -> Path:
    camera = Camera(WIDTH, HEIGHT, *layouts.INTRINSICS)
    projection = np.column_stack([camera.matrix, np.zeros(3)])
    known = CalibrationMessage(1, "cam0", camera, np.eye(3), projection)
    topic = "/cam0/image_raw"
    if isinstance(message, CompressedImageMessage):
        topic += "/compressed"
    return mcap_logs.write_log(path, [("/cam0/camera_info", known), (topic, message)])


def raw(pixel_format: str, image: Pixels) -> Message:
    return ImageMessage(1, "cam0", WIDTH, HEIGHT, pixel_format, image.tobytes(), image.strides[0])


def read(path: Path, kind: str) -> Pixels:
    (frame,) = open_source(path, mode="mono").frames(images=kind)  # type: ignore[arg-type]
    return frame.image0


@pytest.mark.parametrize("image", [COLOUR, DEEP, DEEP_COLOUR], ids=["8 x 3", "16", "16 x 3"])
def test_images_of_files_are_exact(tmp_path: Path, image: Pixels) -> None:
    path = folder_of(tmp_path / "a", image)
    assert np.array_equal(read(path, "recorded"), image)
    assert read(path, "recorded").dtype == image.dtype
    brightest = 4 if image is DEEP else 8  # bits to drop
    reduced = image if image.dtype == np.uint8 else (image >> brightest).astype(np.uint8)
    assert np.array_equal(read(path, "colour"), reduced)
    grey = read(path, "grey")
    assert grey.shape == (HEIGHT, WIDTH) and grey.dtype == np.uint8


def test_alpha_is_dropped_and_grey_stays_grey(tmp_path: Path) -> None:
    alpha = np.dstack([COLOUR, COLOUR[:, :, 0]])
    assert np.array_equal(read(folder_of(tmp_path / "a", alpha), "recorded"), COLOUR)
    grey = COLOUR[:, :, 0]
    assert np.array_equal(read(folder_of(tmp_path / "b", grey), "recorded"), grey)
    smooth = cv2.GaussianBlur(grey, (0, 0), 3)
    assert read(folder_of(tmp_path / "c", smooth, ".jpg"), "recorded").ndim == 2


@pytest.mark.parametrize(
    ("pixel_format", "image", "expected"),
    [
        ("bgr8", COLOUR, COLOUR),
        ("rgb8", COLOUR[:, :, ::-1].copy(), COLOUR),
        ("rgba8", np.dstack([COLOUR[:, :, ::-1], COLOUR[:, :, 0]]), COLOUR),
        ("bgra8", np.dstack([COLOUR, COLOUR[:, :, 0]]), COLOUR),
        ("bgr16", DEEP_COLOUR, DEEP_COLOUR),
        ("mono16", DEEP, DEEP),
        ("mono8", COLOUR[:, :, 1].copy(), COLOUR[:, :, 1]),
    ],
)
def test_images_of_raw_messages_are_exact(
    tmp_path: Path, pixel_format: str, image: Pixels, expected: Pixels
) -> None:
    path = log_of(tmp_path / "a.mcap", raw(pixel_format, image))
    assert np.array_equal(read(path, "recorded"), expected)


@pytest.mark.parametrize(
    ("pattern", "corner"), [("rggb", (0, 0)), ("bggr", (1, 1)), ("gbrg", (1, 0)), ("grbg", (0, 1))]
)
def test_bayer_patterns_are_converted_to_colour(
    tmp_path: Path, pattern: str, corner: tuple[int, int]
) -> None:
    mosaic = np.full((HEIGHT, WIDTH), 100, np.uint8)
    mosaic[corner[0] :: 2, corner[1] :: 2] = 200  # red
    mosaic[1 - corner[0] :: 2, 1 - corner[1] :: 2] = 50  # blue
    image = read(log_of(tmp_path / "a.mcap", raw(f"bayer_{pattern}8", mosaic)), "recorded")
    assert (image[4:-4, 4:-4] == (50, 100, 200)).all()


@pytest.mark.parametrize(("pixel_format", "luma"), [("yuv422", 1), ("yuv422_yuy2", 0)])
def test_yuv_is_converted_to_colour(tmp_path: Path, pixel_format: str, luma: int) -> None:
    packed = np.zeros((HEIGHT, WIDTH, 2), np.uint8)
    packed[:, :, luma] = 81
    packed[:, 0::2, 1 - luma], packed[:, 1::2, 1 - luma] = 90, 240  # red by BT.601
    image = read(log_of(tmp_path / "a.mcap", raw(pixel_format, packed)), "recorded")
    assert np.abs(image.astype(int) - (0, 0, 255)).max() <= 3


def check_red(path: Path) -> None:
    image = read(path, "recorded")
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(image[8:-8, 8:-8].astype(int) - (30, 40, 220)).max() <= 6
    assert read(path, "grey").shape == (HEIGHT, WIDTH)


RED = np.full((HEIGHT, WIDTH, 3), (30, 40, 220), np.uint8)


def compressed(path: Path) -> Path:
    data = cv2.imencode(".jpg", RED)[1].tobytes()
    log_of(path.with_suffix(".mcap"), CompressedImageMessage(1, "cam0", "jpeg", data))
    return path.with_suffix(".mcap")


def video(path: Path) -> Path:
    path = path.with_suffix(".mp4")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(10))
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(RED, format="bgr24")))
        container.mux(stream.encode())
    layouts.write_text(path.with_suffix(".yaml"), layouts.CALIBRATION)
    return path


@pytest.mark.parametrize("make", [compressed, video])
def test_compressed_images_keep_their_colour(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    check_red(make(tmp_path / "a"))
