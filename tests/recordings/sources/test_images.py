from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.base.types import Bytes
from vo.recordings.sources.grey_levels import GreyLevels
from vo.recordings.sources.images import ImageFile, estimate_bit_depth

RNG = np.random.default_rng(3)
GREY = RNG.integers(0, 256, (40, 60), dtype=np.uint8)


def read(path: Path, bit_depth: int = 16) -> Bytes:
    return GreyLevels(bit_depth).to_8_bits(ImageFile(path).read(), 0)


def bits_of(paths: list[Path]) -> int:
    return estimate_bit_depth([ImageFile(path) for path in paths])


def _written(path: Path, pixels: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), pixels)
    return path


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".pgm", ".tif"])
def test_grey_images_are_exact(tmp_path: Path, suffix: str) -> None:
    assert np.array_equal(read(_written(tmp_path / f"a{suffix}", GREY)), GREY)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("suffix", [".png", ".tif", ".webp", ".pgm", ".ppm"])
def test_reads_all_bit_depths_and_channels(
    tmp_path: Path, suffix: str, bits: int, channels: int
) -> None:
    if (suffix == ".webp" and bits == 16) or channels not in {".pgm": [1], ".ppm": [3]}.get(
        suffix, [1, 3, 4]
    ):
        pytest.skip("there are no such files")
    kind = np.dtype(f"uint{bits}")
    pixels = GREY.astype(kind) << (bits - 8)
    layers = [pixels] * min(channels, 3) + [np.full_like(pixels, 2**bits - 1)] * (channels - 3)
    path = tmp_path / f"a{suffix}"
    lossless = [cv2.IMWRITE_WEBP_QUALITY, 101] if suffix == ".webp" else []
    assert cv2.imwrite(str(path), np.dstack(layers), lossless)
    assert ImageFile(path).read().dtype == kind
    np.testing.assert_array_equal(read(path), GREY)


def test_jpeg_is_nearly_exact(tmp_path: Path) -> None:
    smooth = cv2.GaussianBlur(GREY, (0, 0), 3)
    image = read(_written(tmp_path / "a.jpg", smooth))
    assert np.abs(image.astype(int) - smooth).max() <= 4


def test_colour_is_converted_to_grey(tmp_path: Path) -> None:
    blue_green_red = np.tile(np.array([200, 100, 50], np.uint8), (40, 60, 1))
    image = read(_written(tmp_path / "a.png", blue_green_red))
    assert image.shape == (40, 60)
    assert abs(int(image[0, 0]) - (0.114 * 200 + 0.587 * 100 + 0.299 * 50)) <= 1


@pytest.mark.parametrize(
    ("brightest", "bits"), [(900, 10), (1023, 10), (1024, 12), (4095, 12), (16000, 14), (65535, 16)]
)
def test_16_bit_images_are_scaled_by_their_bit_depth(
    tmp_path: Path, brightest: int, bits: int
) -> None:
    pixels = np.zeros((40, 60), np.uint16)
    pixels[5, 6] = brightest
    path = _written(tmp_path / "a.png", pixels)
    assert bits_of([path]) == bits
    image = read(path, bits)
    assert image.dtype == np.uint8
    assert image[5, 6] == brightest * 256 // 2**bits


def test_16_bit_pixels_above_the_bit_depth_saturate(tmp_path: Path) -> None:
    path = _written(tmp_path / "a.png", np.full((4, 4), 5000, np.uint16))
    assert (read(path, 12) == 255).all()


def test_bit_depth_is_that_of_the_brightest_image(tmp_path: Path) -> None:
    paths = [
        _written(tmp_path / f"{i}.png", np.full((4, 4), 100 + 1000 * i, np.uint16))
        for i in range(4)
    ]
    (tmp_path / "4.png").write_bytes(b"damaged")
    assert bits_of([*paths, tmp_path / "4.png"]) == 12
    assert bits_of([_written(tmp_path / "grey.png", GREY)]) == 8


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".pgm", ".webp"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_error_for_truncated_files_without_output_of_opencv(
    tmp_path: Path, suffix: str, share: float, capfd: pytest.CaptureFixture[str]
) -> None:
    path = _written(tmp_path / f"a{suffix}", GREY)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(SourceError, match=str(path)):
        read(path)
    assert capfd.readouterr() == ("", "")


def test_error_for_a_png_with_a_flipped_bit(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = _written(tmp_path / "a.png", GREY)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(SourceError, match="cut off or damaged"):
        read(path)
    assert capfd.readouterr() == ("", "")


def test_end_of_a_thumbnail_is_not_the_end_of_a_jpeg(tmp_path: Path) -> None:
    path = _written(tmp_path / "a.jpg", GREY)
    data = path.read_bytes()
    thumbnail = b"\xff\xe1" + (2 + 6).to_bytes(2, "big") + b"\xff\xd8  \xff\xd9"
    path.write_bytes(data[:2] + thumbnail + data[2:])
    assert read(path).shape == GREY.shape
    path.write_bytes((data[:2] + thumbnail + data[2:])[:-50])
    with pytest.raises(SourceError, match="cut off"):
        read(path)


def test_accepts_jpegs_with_padding_at_the_end(tmp_path: Path) -> None:
    path = _written(tmp_path / "a.jpg", GREY)
    path.write_bytes(path.read_bytes() + bytes(100))
    assert read(path).shape == GREY.shape


@pytest.mark.parametrize(
    ("content", "reason"), [(b"", "is empty"), (b"text", "damaged or not an image")]
)
def test_error_names_the_problem(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(SourceError, match=reason):
        read(tmp_path / "a.png")


def test_missing_files_and_folders(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="does not exist"):
        read(tmp_path / "a.png")
    with pytest.raises(SourceError, match="cannot be read"):
        read(tmp_path)


def test_error_for_floating_point_pixels(tmp_path: Path) -> None:
    path = _written(tmp_path / "a.tif", GREY.astype(np.float32))
    with pytest.raises(SourceError, match="float32 pixels; 8 or 16 bits"):
        read(path)


def test_log_level_of_opencv_is_restored(tmp_path: Path) -> None:
    before = cv2.utils.logging.getLogLevel()
    with pytest.raises(SourceError):
        read(_written(tmp_path / "a.png", GREY).with_suffix(".jpg"))
    read(tmp_path / "a.png")
    assert cv2.utils.logging.getLogLevel() == before
