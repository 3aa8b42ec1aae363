"""Masks of a whole run: which camera they are for, their size, and their rectification."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.base.config import MasksConfig
from vo.base.errors import ConfigError
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.base.images.recorded_masks import read_mask
from vo.base.types import Bools, Bytes, Camera, Rig
from vo.engine.frontend.static_masks import StaticMasks, recorded_masks

WIDTH, HEIGHT = 160, 120
CAMERA = Camera(WIDTH, HEIGHT, 100.0, 100.0, 79.5, 59.5)
MONO = Rig(CAMERA)
RIGHT_FROM_LEFT = np.array(
    [[1.0, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=np.float64
)
STEREO = Rig(CAMERA, CAMERA, RIGHT_FROM_LEFT)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[90:] = 0
    path = tmp_path / "bonnet.png"
    assert cv2.imwrite(str(path), mask)
    return path


def _hidden(rig: Rig, **section: tuple[str, ...]) -> list[float]:
    masks = recorded_masks(MasksConfig(**section), rig)
    return [0.0 if m is None else float(np.mean(m == 0)) for m in masks]


def test_without_masks_there_are_none() -> None:
    assert recorded_masks(MasksConfig(), STEREO) == (None, None)
    masks = StaticMasks(rectified_rig(STEREO), (None, None))
    assert masks.left is None and masks.right(rectified_rig(STEREO)) is None
    assert masks.hidden == (0.0, 0.0)


def test_files_are_those_of_the_left_and_the_right_camera(file: Path) -> None:
    one = str(file)
    assert _hidden(STEREO, files=(one,)) == [0.25, 0.0]
    assert _hidden(STEREO, files=(one, one)) == [0.25, 0.25]
    assert _hidden(STEREO, files=(f"right:{one}",)) == [0.0, 0.25]
    assert _hidden(STEREO, files=(f"both:{one}",)) == [0.25, 0.25]
    assert _hidden(MONO, files=(one, one)) == [0.25]  # settings of a robot, run with one camera


def test_areas_add_to_the_file_of_their_camera(file: Path) -> None:
    areas = ("0,0,160,12", "right:0,0,80,120", "0,110,160,500")
    assert _hidden(STEREO, files=(str(file),), ignore=areas) == pytest.approx([0.35, 0.5])


def test_a_region_of_interest_hides_the_rest() -> None:
    roi = ("10,10,80,60", "50,10,80,60")
    assert _hidden(STEREO, roi=roi) == [1.0 - 120 * 60 / (160 * 120), 0.0]
    assert _hidden(MONO, roi=roi, ignore=("0,0,160,40",)) == [1.0 - 120 * 30 / (160 * 120)]


def test_a_polygon_is_filled() -> None:
    triangle = _hidden(MONO, ignore=("0,0,159,0,0,119",))[0]
    assert triangle == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("section", "complaint"),
    [
        ({"ignore": ("200,0,40,40",)}, "area '200,0,40,40' is outside of the left images"),
        ({"ignore": ("right:0,-90,40,40",)}, "outside of the right images, which are 160x120"),
        ({"ignore": ("-5,-5,500,500",)}, "leave nothing of the left images"),
        ({"roi": ("0,0,50,50",), "ignore": ("0,0,60,60",)}, "leave nothing of the left images"),
        ({"files": ("a.png", "b.png", "c.png")}, "more masks than cameras"),
        ({"files": ("a.png", "left:b.png")}, "two left masks"),
        ({"files": ("a.png",)}, "a.png cannot be read"),
    ],
)
def test_what_cannot_be_meant_is_refused(
    section: dict[str, tuple[str, ...]], complaint: str
) -> None:
    with pytest.raises(ConfigError, match=complaint):
        recorded_masks(MasksConfig(**section), STEREO)


def test_a_mask_of_another_size_is_refused(tmp_path: Path) -> None:
    for size, complaint in (((80, 60), "is 60x80, not the size of"), ((160, 120), "turned by 90")):
        assert cv2.imwrite(str(tmp_path / "m.png"), np.full(size, 255, np.uint8))
        with pytest.raises(ConfigError, match=complaint) as error:
            recorded_masks(MasksConfig(files=(str(tmp_path / "m.png"),)), MONO)
        assert "160x120" in str(error.value)


def test_a_region_smaller_than_a_patch_is_refused() -> None:
    recorded = recorded_masks(MasksConfig(roi=("40,40,20,20",)), MONO)
    with pytest.raises(ConfigError, match="leave nothing of the left images, with 16 pixels"):
        StaticMasks(rectified_rig(MONO), recorded)


def test_masks_that_hide_nothing_or_most_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mask = np.full((HEIGHT, WIDTH), 30, np.uint8)
    assert cv2.imwrite(str(tmp_path / "m.png"), mask)
    config = MasksConfig(files=(str(tmp_path / "m.png"),))
    assert recorded_masks(config, MONO) == (None,)
    assert "has no black pixel (0) and hides nothing" in caplog.text
    mask[20:] = 0
    assert cv2.imwrite(str(tmp_path / "m.png"), mask)
    recorded_masks(config, MONO)
    assert "hides 83 % of the left images: black (0) is not used" in caplog.text


def test_masks_are_rectified_with_the_images() -> None:
    """A bar that a mask hides is in the rectified image where the mask is, for both cameras."""
    turned = cv2.Rodrigues(np.array([0.02, -0.03, 0.05]))[0]
    right_from_left = RIGHT_FROM_LEFT.copy()
    right_from_left[:3, :3] = turned
    lens = replace(CAMERA, distortion_model="radtan", distortion=(-0.25, 0.05, 0.0, 0.0))
    rig = rectified_rig(Rig(lens, lens, right_from_left))
    image = np.full((HEIGHT, WIDTH), 200, np.uint8)
    image[50:70] = 90
    recorded = np.where(image == 90, np.uint8(0), np.uint8(255))
    masks = StaticMasks(rig, (recorded, recorded))
    corrected = rig.with_right_corrected(VerticalDisparity(pitch_px=2.0))
    for each, mask, side in (
        (rig, masks.left, 0),
        (rig, masks.right(rig), 1),
        (corrected, masks.right(corrected), 1),
    ):
        assert mask is not None
        assert mask[each.rectify(image, side) < 200].max(initial=0) == 0
        assert mask.any()
    assert masks.right(corrected) is masks.right(corrected)  # not once for every frame


def test_a_mask_of_one_frame_is_joined_with_that_of_the_run() -> None:
    rig = rectified_rig(MONO)
    masks = StaticMasks(rig, recorded_masks(MasksConfig(ignore=("0,100,160,20",)), MONO))
    of_frame: Bytes = np.full((HEIGHT, WIDTH), 255, np.uint8)
    of_frame[:, :20] = 0
    both = masks.left_with(of_frame)
    assert both is not None and masks.left is not None
    assert not both[:, : 20 + 16].any() and not both[100 - 16 :].any()
    assert both[: 100 - 16, 20 + 16 :].all()
    assert masks.left_with(None) is masks.left
    assert masks.left[:, :20].any()


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
