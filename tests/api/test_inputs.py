"""What a caller may give, and the message for what cannot be meant."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest

import vo

SIZE = (240, 320)
CAMERA = vo.Camera(320, 240, 200.0, 200.0, 160.0, 120.0)
GREY = np.random.default_rng(0).integers(0, 256, SIZE, dtype=np.uint8)


def pair() -> vo.Rig:
    cam1_from_cam0 = np.eye(4)
    cam1_from_cam0[0, 3] = -0.1
    return vo.Rig(CAMERA, CAMERA, cam1_from_cam0)


Make = Callable[..., vo.Odometry]


@pytest.fixture
def make() -> Iterator[Make]:
    opened: list[vo.Odometry] = []

    def make(rig: vo.Rig, **options: Any) -> vo.Odometry:
        opened.append(vo.Odometry(rig, overrides=["threads=1"], **options))
        return opened[-1]

    yield make
    for odometry in opened:
        odometry.close()


@pytest.mark.parametrize(
    ("stamp", "message"),
    [
        (1.5, "stamp_ns is 1.5, a float; give integer nanoseconds, for seconds round(1e9 *"),
        (np.float64(2), "a float; give integer nanoseconds"),
        (True, "stamp_ns is of type bool; give integer nanoseconds"),
        (None, "stamp_ns is None; give integer nanoseconds, such as time.time_ns()"),
        ("1", "stamp_ns is of type str"),
        (np.array([1, 2]), "stamp_ns is no integer"),
        (-1, "stamp_ns is -1; give nanoseconds from 0 to 2**63 - 1"),
        (2**63, "give nanoseconds from 0"),
        (1000, "stamp_ns is 1000, the frame before had 1000; stamps must increase"),
        (999, "stamp_ns is 999, the frame before had 1000"),
    ],
)
def test_a_stamp_that_cannot_be_meant_is_refused(make: Make, stamp: Any, message: str) -> None:
    odometry = make(vo.Rig(CAMERA))
    odometry.track(1000, GREY)
    with pytest.raises(vo.InputError) as error:
        odometry.track(stamp, GREY)
    assert message in str(error.value)
    assert odometry.track(np.int64(1001), GREY).stamp_ns == 1001  # and it goes on


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (None, "left is None; give an (H, W) or (H, W, 3) array of uint8 or uint16"),
        ("left.png", "left is of type str"),
        (GREY.astype(np.float32), "pixels of float32; give uint8 or uint16; scale it to 0 to 255"),
        (GREY.astype(np.int32), "pixels of int32; give uint8 or uint16"),
        (GREY > 3, "pixels of bool"),
        (GREY[:, :100], "left has 100x240 pixels, the calibration is for 320x240; give images as"),
        (GREY.T, "left has 240x320 pixels, the calibration is for 320x240; are rows and columns"),
        (GREY[None], "left has shape (1, 240, 320); give (H, W) in grey or (H, W, 3) in colour"),
        (np.dstack([GREY, GREY]), "left has shape (240, 320, 2)"),
        (np.empty(0, np.uint8), "left has shape (0,)"),
        ([[1, 2], [3]], "left is of type list"),
        (np.ma.masked_array(GREY, GREY > 3), "left is a masked array"),
        (object(), "left is of type object"),
    ],
)
def test_an_image_that_cannot_be_meant_is_refused(make: Make, image: Any, message: str) -> None:
    odometry = make(vo.Rig(CAMERA))
    with pytest.raises(vo.InputError) as error:
        odometry.track(0, image)
    assert message in str(error.value)
    assert odometry.track(0, GREY).frame_index == 0


def test_further_images_need_a_rig_that_has_them(make: Make) -> None:
    mono, stereo = make(vo.Rig(CAMERA)), make(pair())
    depth = np.ones(SIZE, np.float32)
    with pytest.raises(vo.InputError, match="right is given, but the calibration has one camera"):
        mono.track(0, GREY, GREY)
    with pytest.raises(vo.InputError, match="create the odometry with has_depth=True"):
        mono.track(0, GREY, depth=depth)
    with pytest.raises(vo.InputError, match="a pair of cameras does not use it"):
        stereo.track(0, GREY, GREY, depth)
    with pytest.raises(vo.InputError, match="left is uint8, right is uint16; give both alike"):
        stereo.track(0, GREY, GREY.astype(np.uint16))
    with pytest.raises(vo.InputError, match="right has 100x240 pixels"):
        stereo.track(0, GREY, GREY[:, :100])
    with pytest.raises(vo.InputError, match="mask is uint8 of shape"):
        mono.track(0, GREY, mask=np.dstack([GREY] * 3))
    with pytest.raises(vo.InputError, match="depth has pixels of int64; give an"):
        make(vo.Rig(CAMERA), has_depth=True).track(0, GREY, depth=depth.astype(np.int64))


def image_of(odometry: vo.Odometry) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return odometry.snapshot().view.image0


@pytest.mark.parametrize(
    ("colour", "image"),
    [
        ("bgr", cv2.cvtColor(GREY, cv2.COLOR_GRAY2BGR)),
        ("bgr", cv2.cvtColor(GREY, cv2.COLOR_GRAY2BGRA)),
        ("rgb", cv2.cvtColor(GREY, cv2.COLOR_GRAY2BGR)),
        ("bgr", GREY[:, :, None]),
        ("bgr", np.asfortranarray(GREY)),
        ("bgr", np.repeat(GREY, 2, axis=1)[:, ::2]),
        ("bgr", GREY[::-1][::-1]),
    ],
)
def test_images_of_any_layout_are_the_same_image(make: Make, colour: str, image: Any) -> None:
    odometry = make(vo.Rig(CAMERA), colour=colour)
    odometry.track(0, image)
    assert np.abs(image_of(odometry).astype(int) - GREY).max() <= 1


def test_the_order_of_colours_counts(make: Make) -> None:
    red = np.zeros((*SIZE, 3), np.uint8)
    red[:, :, 2] = 200
    levels = []
    for colour in ("bgr", "rgb"):
        odometry = make(vo.Rig(CAMERA), colour=colour)
        odometry.track(0, red)
        levels.append(int(image_of(odometry)[0, 0]))
    assert levels == [60, 23]  # 0.299 and 0.114 of 200


def test_a_buffer_may_be_used_again(make: Make) -> None:
    odometry = make(vo.Rig(CAMERA))
    buffer = GREY.copy()
    odometry.track(0, buffer)
    buffer[:] = 0
    np.testing.assert_array_equal(image_of(odometry), GREY)


def test_16_bits_are_spread_over_8_slowly(make: Make) -> None:
    odometry = make(vo.Rig(CAMERA))
    thermal = (8000 + 2 * GREY.astype(np.uint16)).astype(">u2")
    odometry.track(0, thermal)
    low, high = np.percentile(image_of(odometry), [1, 99])
    assert 15 <= low <= 30
    assert 225 <= high <= 240
    odometry.track(1, thermal + np.uint16(250))  # half of the range brighter
    assert np.median(image_of(odometry)) > 200


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"calibration": 3}, "calibration is of type int; give a file"),
        ({"calibration": "nope.yaml"}, "calibration file nope.yaml does not exist"),
        ({"mode": "both"}, "mode is 'both'; give 'auto', 'mono' or 'stereo'"),
        ({"mode": "stereo"}, "mode is 'stereo', but the calibration has one camera only"),
        ({"colour": "hsv"}, "colour is 'hsv'; give 'bgr' (OpenCV) or 'rgb'"),
        ({"config": "nope"}, "nope"),
        ({"config": 3}, "config is of type int; give a preset, a file or a vo.Config"),
        ({"overrides": ["tracking.every=2"]}, "tracking.every is 2; single frames need 1"),
        ({"overrides": ["nope.nope=2"]}, "nope"),
    ],
)
def test_an_argument_that_cannot_be_meant_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(vo.VoError) as error:
        vo.Odometry(**{"calibration": vo.Rig(CAMERA), **options})
    assert message in str(error.value)


def test_a_closed_odometry_takes_no_frames(make: Make) -> None:
    odometry = make(vo.Rig(CAMERA))
    odometry.track(0, GREY)
    odometry.close()
    odometry.close()
    with pytest.raises(vo.VoError, match="takes no more frames: it is closed; create another"):
        odometry.track(1, GREY)
    assert len(odometry.trajectory()) == 0
    assert odometry.summary().verdict.word == "no path"
