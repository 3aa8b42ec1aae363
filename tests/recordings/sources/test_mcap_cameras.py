"""Cameras of a log: calibration, extrinsics, depth and ground truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import layouts
import numpy as np
import pytest
from camera_logs import (
    CAM1_FROM_CAM0,
    FISHEYE,
    LENS,
    RATIONAL,
    OnTopic,
    calibration,
    fixed,
    images,
    log,
)
from mcap.writer import Writer
from mcap_logs import DIALECTS, write_log
from rosbags.typesys import Stores, get_typestore

from vo.base.errors import CalibrationError, NoCalibration, NoPairCalibration, SourceError
from vo.base.geometry.transforms import inverse, se3_exp
from vo.base.types import Camera
from vo.recordings.formats.messages import (
    CompressedImageMessage,
    FrameTransform,
    ImageMessage,
    PoseMessage,
    TransformsMessage,
)
from vo.recordings.formats.warning_kinds import collected_warnings
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.uncalibrated import open_uncalibrated


@pytest.mark.parametrize(
    "lens", [LENS, FISHEYE, RATIONAL, replace(LENS, distortion_model="none", distortion=())]
)
@pytest.mark.parametrize("dialect", DIALECTS)
def test_lens_models_are_exact(tmp_path: Path, lens: Camera, dialect: str) -> None:
    parts = images("/camera/image", "c"), calibration("/camera/camera_info", "c", lens)
    assert open_source(log(tmp_path, *parts, dialect=dialect)).rig.cam0 == lens


def test_calibration_is_found_by_its_frame(tmp_path: Path) -> None:
    path = log(
        tmp_path,
        images("/camera/image", "optical"),
        calibration("/somewhere/else", "other", FISHEYE),
        calibration("/calibrations/front", "optical"),
    )
    assert open_source(path).rig.cam0 == LENS


def test_error_without_calibration_lists_the_topics(tmp_path: Path) -> None:
    path = log(tmp_path, images("/camera/image", "a"), calibration("/other/camera_info", "b"))
    with pytest.raises(CalibrationError) as caught:
        open_source(path)
    assert "no calibration for /camera/image" in str(caught.value)
    assert "/other/camera_info" in str(caught.value)
    assert "`calibration=FILE`" in str(caught.value)
    layouts.write_text(tmp_path / "mine.yaml", layouts.CALIBRATION)
    rig = open_source(path, calibration=tmp_path / "mine.yaml").rig
    assert rig.cam0.fx == layouts.INTRINSICS[0]


def test_a_pair_without_any_calibration_can_be_estimated_by_its_baseline(tmp_path: Path) -> None:
    pair = log(tmp_path, images("/left/image", "a"), images("/right/image", "b"))
    for mode in ("auto", "stereo"):
        with pytest.raises(NoPairCalibration, match=r"`camera\.baseline_m=0\.12`, to estimate"):
            open_source(pair, mode=mode)
    assert open_uncalibrated(pair, mode="stereo").rig.is_stereo
    with pytest.raises(NoCalibration):
        open_source(pair, mode="mono")


def test_one_camera_without_any_calibration_can_be_estimated(tmp_path: Path) -> None:
    one = log(tmp_path, images("/camera/image", "a"))
    with pytest.raises(NoCalibration, match="no calibration for /camera/image"):
        open_source(one)
    assert open_uncalibrated(one, mode="mono").rig.cam0.width == LENS.width
    unset = replace(LENS, fx=0.0, fy=0.0, cx=0.0, cy=0.0, distortion_model="none", distortion=())
    path = log(
        tmp_path, images("/camera/image", "a"), calibration("/camera/camera_info", "a", unset)
    )
    with pytest.raises(NoCalibration, match="never calibrated"):
        open_source(path)
    pair = log(tmp_path, images("/cam0/image", "a"), images("/cam1/image", "b"))
    with pytest.raises(CalibrationError) as caught:
        open_source(pair)
    assert not isinstance(caught.value, NoCalibration)
    with pytest.raises(NoCalibration):
        open_source(pair, mode="mono")


def test_baseline_through_intermediate_frames(tmp_path: Path) -> None:
    body_from_a, body_from_b = (
        se3_exp(np.full(6, 0.3)),
        se3_exp(np.full(6, 0.3)) @ inverse(CAM1_FROM_CAM0),
    )
    path = log(
        tmp_path,
        images("/cam0/image", "a_optical"),
        images("/cam1/image", "b_optical"),
        calibration("/cam0/camera_info", "a_optical"),
        calibration("/cam1/camera_info", "b_optical"),
        fixed(("map", "body", np.eye(4)), ("body", "a_link", body_from_a)),
        fixed(("a_link", "a_optical", np.eye(4)), ("body", "b_optical", body_from_b)),
    )  # fmt: skip
    found = open_source(path).rig.cam1_from_cam0
    assert found is not None
    np.testing.assert_allclose(found, CAM1_FROM_CAM0, atol=1e-12)


def test_moving_frames_are_not_used(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    moving = [
        ("/tf", TransformsMessage(i + 1, (FrameTransform("a", "b", se3_exp(np.full(6, 0.1 * i))),)))
        for i in range(3)
    ]
    parts = (
        images("/cam0/image", "a"),
        images("/cam1/image", "b"),
        calibration("/cam0/camera_info", "a"),
        calibration("/cam1/camera_info", "b"),
        moving,
    )
    path = log(tmp_path, *parts)
    assert not open_source(path).rig.is_stereo
    (record,) = caplog.records
    assert "no transforms connect frame 'a' to 'b'" in record.getMessage()
    with pytest.raises(CalibrationError, match="unknown pose of /cam1/image relative to"):
        open_source(path, mode="stereo")


def test_baseline_from_the_rectification(tmp_path: Path) -> None:
    turn0, turn1 = (
        se3_exp(np.array([0.01, 0.02, 0, 0, 0, 0])),
        se3_exp(np.array([0, 0.03, 0.01, 0, 0, 0])),
    )
    path = log(
        tmp_path,
        images("/left/image_raw", "same"),
        images("/right/image_raw", "same"),
        calibration("/left/camera_info", "same", turn=turn0[:3, :3]),
        calibration("/right/camera_info", "same", shift=-0.12, turn=turn1[:3, :3]),
    )
    expected = inverse(turn1) @ se3_exp(np.array([0, 0, 0, -0.12, 0, 0])) @ turn0
    found = open_source(path).rig.cam1_from_cam0
    assert found is not None
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_rectified_images_have_the_rectified_intrinsics(tmp_path: Path) -> None:
    path = log(
        tmp_path,
        images("/left/image_rect", "same"),
        images("/right/image_rect", "same"),
        calibration("/left/camera_info", "same"),
        calibration("/right/camera_info", "same", shift=-0.12),
    )
    rig = open_source(path).rig
    assert not rig.cam0.is_distorted
    assert rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(rig.cam1_from_cam0[:3, 3], [-0.12, 0, 0], atol=1e-12)


def _read(tmp_path: Path, encoding: str, pixels: np.ndarray, step: int = 0) -> np.ndarray:
    size = layouts.WIDTH, layouts.HEIGHT
    parts = [
        ("/camera/image", ImageMessage(stamp, "c", *size, encoding, pixels.tobytes(), step))
        for stamp in layouts.STAMPS_NS[:4]
    ]
    path = log(tmp_path, parts, calibration("/camera/camera_info", "c"))
    return next(iter(open_source(path).frames())).image0


@pytest.mark.parametrize("stated", ["yuv422", "yuv422_yuy2"])
@pytest.mark.parametrize("brightness", [0, 1])
def test_the_order_of_brightness_and_colour_is_that_of_the_pixels(
    tmp_path: Path, stated: str, brightness: int, caplog: pytest.LogCaptureFixture
) -> None:
    grey = layouts.image(0)
    pixels = np.full((*grey.shape, 2), 128, np.uint8)
    pixels[:, ::2, 1 - brightness] = 90  # one of both colours
    pixels[:, :, brightness] = grey
    np.testing.assert_array_equal(_read(tmp_path, stated, pixels), grey)
    assert ("not as stated" in caplog.text) == ((stated == "yuv422") == (brightness == 0))


def test_pixels_of_more_bytes_than_stated_are_refused(tmp_path: Path) -> None:
    grey = cv2.GaussianBlur(layouts.image(0), (0, 0), 3)
    deep = (grey.astype(np.uint16) << 4).view(np.uint8).reshape(*grey.shape, 2)
    rgba = np.dstack([grey, grey, grey, np.full_like(grey, 255)])
    for encoding, pixels, count in (("mono8", deep, 2), ("rgb8", rgba, 4)):
        with pytest.raises(SourceError, match=f"{count} bytes for each pixel, which {encoding}"):
            _read(tmp_path, encoding, pixels, step=count * layouts.WIDTH)
    beside = np.hstack([grey, grey])  # the left one of two in one buffer
    half = np.array(_read(tmp_path, "mono8", beside[:, : 2 * layouts.WIDTH], 2 * layouts.WIDTH))
    assert np.array_equal(half, grey)


def test_a_step_of_a_pixel_is_ignored(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    grey = layouts.image(0)
    pixels = np.dstack([grey, grey, grey, grey])
    np.testing.assert_allclose(_read(tmp_path, "rgba8", pixels, step=4), grey, atol=1)
    assert "rgba8 are said to have 4 bytes" in caplog.text


EMPTY = Camera(layouts.WIDTH, layouts.HEIGHT, 0.0, 0.0, 0.0, 0.0)


def test_the_calibration_of_most_messages_is_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The first one may be empty, garbage, or of another size."""
    other = replace(LENS, width=2 * LENS.width, height=2 * LENS.height, cx=2 * LENS.cx)
    first = [EMPTY, replace(LENS, fy=1.0), other]
    parts = [calibration("/camera/camera_info", "c", each) for each in (*first, LENS, LENS)]
    assert open_source(log(tmp_path, images("/camera/image", "c"), parts)).rig.cam0 == LENS
    assert "1 of 3 calibrations of the log differ" in caplog.text


def test_a_focal_length_that_changes_is_a_doubt(tmp_path: Path) -> None:
    zoomed = replace(LENS, fx=1.2 * LENS.fx)
    parts = [calibration("/camera/camera_info", "c", each) for each in (LENS, LENS, zoomed)]
    with collected_warnings() as warnings:
        open_source(log(tmp_path, images("/camera/image", "c"), parts))
    assert [each.is_doubt for each in warnings] == [True]
    assert "in the focal length by up to +20.0%: zoom?" in warnings[0].text


@pytest.mark.parametrize("last", ["image_rect", "image_raw"])
def test_p_without_k_is_that_of_rectified_images(tmp_path: Path, last: str) -> None:
    parts = []
    for side, shift in (("left", 0.0), ("right", -0.12)):
        topic, good = calibration(f"/{side}/camera_info", side, shift=shift)
        parts += [(topic, replace(good, camera=EMPTY)), *images(f"/{side}/{last}", side)]
    path = log(tmp_path, parts)
    if last == "image_raw":
        with pytest.raises(CalibrationError, match="K is zero: .*topic of rectified images"):
            open_source(path)
        return
    rig = open_source(path).rig
    assert rig.cam0.fx == LENS.fx and not rig.cam0.is_distorted
    assert rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(rig.cam1_from_cam0[:3, 3], [-0.12, 0, 0], atol=1e-12)


def test_error_for_the_same_projection_of_both_cameras(tmp_path: Path) -> None:
    sides = [
        part
        for side in ("left", "right")
        for part in (*images(f"/{side}/image_raw", side),
                     calibration(f"/{side}/camera_info", side, shift=-0.12))
    ]  # fmt: skip
    with pytest.raises(CalibrationError, match=r"P of both .* the baseline would be 0\.12 m"):
        open_source(log(tmp_path, sides), mode="stereo")


def test_a_matrix_of_garbage_is_refused(tmp_path: Path) -> None:
    path = log(
        tmp_path,
        images("/camera/image", "c"),
        calibration("/camera/camera_info", "c", replace(LENS, fx=772.9, fy=1.0)),
    )
    with pytest.raises(CalibrationError, match=r"focal length is 772\.9, 1; it must be above 0"):
        open_source(path)


@pytest.mark.parametrize("chained", [True, False])
def test_ground_truth_is_transformed_to_the_camera(
    tmp_path: Path, chained: bool, caplog: pytest.LogCaptureFixture
) -> None:
    body_from_cam = se3_exp(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    poses = [se3_exp(np.full(6, 0.1 * i)) for i in range(4)]
    path = log(
        tmp_path,
        images("/camera/image", "c"),
        calibration("/camera/camera_info", "c"),
        [
            ("/vicon/pose", PoseMessage(s, "w", p))
            for s, p in zip(layouts.STAMPS_NS, poses, strict=False)
        ],
        fixed(("body", "c", body_from_cam)) if chained else [],
    )
    truth = open_source(path).ground_truth
    if chained:
        assert truth is not None
        np.testing.assert_allclose(
            truth.world_from_cam, np.array(poses) @ body_from_cam, atol=1e-12
        )
    else:
        assert truth is None
        assert "/vicon/pose has poses of the body" in caplog.text


def test_messages_without_a_stamp_get_the_log_time(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    parts = [("/camera/image", replace(m, stamp_ns=0)) for _, m in images("/camera/image", "c")]
    times = iter(range(10**8, 10**10, 10**8))
    path = write_log(
        tmp_path / "log.mcap",
        [calibration("/camera/camera_info", "c"), *parts],
        log_ns=lambda _: next(times),
    )
    assert [f.stamp_ns for f in open_source(path).frames()] == [i * 10**8 for i in range(2, 6)]
    (record,) = caplog.records
    assert "4 of 4 messages have no stamp" in record.getMessage()


def test_images_that_repeat_a_stamp_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    twice = [*images("/camera/image", "c"), *images("/camera/image", "c", count=2)]
    path = log(tmp_path, twice, calibration("/camera/camera_info", "c"))
    assert len(open_source(path)) == 4
    assert "2 images repeat a stamp" in caplog.text


def test_ros_1_in_mcap(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    types: Any = store.types
    path = tmp_path / "ros1.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros1")
        channels = {}
        for topic, name in (("/cam/image_raw", "Image"), ("/cam/camera_info", "CameraInfo")):
            kind = f"sensor_msgs/msg/{name}"
            text = store.generate_msgdef(kind, ros_version=1)[0].encode()
            schema = writer.register_schema(f"sensor_msgs/{name}", "ros1msg", text)
            channels[kind] = writer.register_channel(topic, "ros1", schema)
        roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        for i, stamp in enumerate(layouts.STAMPS_NS):
            time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
            header = types["std_msgs/msg/Header"](i, time, "c")
            size, k = (layouts.HEIGHT, layouts.WIDTH), LENS.matrix.ravel()
            d, r = np.array(LENS.distortion), np.eye(3).ravel()
            p = np.column_stack([LENS.matrix, np.zeros(3)]).ravel()
            for record in (
                types["sensor_msgs/msg/Image"](
                    header, *size, "mono8", 0, layouts.WIDTH, layouts.image(i).ravel()
                ),
                types["sensor_msgs/msg/CameraInfo"](
                    header, *size, "plumb_bob", d, k, r, p, 0, 0, roi
                ),
            ):
                kind = record.__msgtype__
                data = bytes(store.serialize_ros1(record, kind))
                writer.add_message(channels[kind], stamp + 5, data, stamp + 5)
        writer.finish()
    source = open_source(path)
    assert source.rig.cam0 == LENS
    for i, frame in enumerate(source.frames()):
        assert frame.stamp_ns == layouts.STAMPS_NS[i]
        assert np.array_equal(frame.image0, layouts.image(i))


DEPTH_M = np.array([[1.5, 0.25], [np.inf, 7.0]], dtype="<f4").repeat(24, axis=0).repeat(32, axis=1)


def depth(topic: str, frame: str, form: str) -> Iterator[OnTopic]:
    size = layouts.WIDTH, layouts.HEIGHT
    millimetres = np.where(np.isfinite(DEPTH_M), DEPTH_M * 1000, 0).astype(np.uint16)
    png = bytes(12) + cv2.imencode(".png", millimetres)[1].tobytes()
    for stamp in layouts.STAMPS_NS[:4]:
        if form == "32FC1":
            yield topic, ImageMessage(stamp + 1000, frame, *size, form, DEPTH_M.tobytes())
        elif form == "16UC1":
            yield topic, ImageMessage(stamp + 1000, frame, *size, form, millimetres.tobytes())
        else:
            yield topic, CompressedImageMessage(stamp + 1000, frame, form, png)


@pytest.mark.parametrize("form", ["32FC1", "16UC1", "16UC1; compressedDepth png"])
def test_depth_in_the_frame_of_the_camera_is_used(tmp_path: Path, form: str) -> None:
    path = log(
        tmp_path,
        images("/camera/color/image_raw", "color"),
        depth("/camera/depth/image_rect_raw", "depth", form),
        depth("/camera/aligned_depth_to_color/image_raw", "color", form),
        calibration("/camera/color/camera_info", "color"),
    )
    source = open_source(path)
    assert source.rig.has_depth
    for frame in source.frames():
        assert frame.depth is not None
        np.testing.assert_array_equal(frame.depth, np.where(np.isfinite(DEPTH_M), DEPTH_M, 0))
    assert not open_source(path, mode="mono").rig.has_depth


def test_depth_in_another_frame_is_ignored(tmp_path: Path) -> None:
    path = log(
        tmp_path,
        images("/camera/color/image_raw", "color"),
        depth("/camera/depth/image_rect_raw", "depth", "16UC1"),
        calibration("/camera/color/camera_info", "color"),
    )
    assert not open_source(path).rig.has_depth


@pytest.mark.parametrize("lost", [None, 2])
def test_cameras_that_look_in_different_directions_are_no_pair(
    tmp_path: Path, lost: int | None
) -> None:
    apart = se3_exp(np.array([0, np.pi * 0.9, 0, 0.1, 0, 0]))
    rear, missing = images("/rear/image", "b"), [] if lost is None else [lost]
    path = log(
        tmp_path,
        images("/front/image", "a"),
        (part for number, part in enumerate(rear) if number != lost),
        calibration("/front/camera_info", "a"),
        calibration("/rear/camera_info", "b"),
        fixed(("b", "a", apart)),
    )
    topics = ["/front/image", "/rear/image"]
    with pytest.raises(CalibrationError, match="differ by 162 degrees, too much for a stereo pair"):
        open_source(path, mode="stereo", topics=topics)
    for source in (open_source(path), open_source(path, topics=topics)):
        np.testing.assert_allclose(source.rig.cam1_from_cam0, apart, atol=1e-9)
        frames = list(source.frames())
        assert [n for n, frame in enumerate(frames) if frame.images[1] is None] == missing
    turned = open_source(path, topics=topics[::-1])
    np.testing.assert_allclose(turned.rig.cam1_from_cam0, np.linalg.inv(apart), atol=1e-9)
    assert [n for n, frame in enumerate(turned.frames()) if frame.images[0] is None] == missing


@pytest.mark.parametrize("odd", [0, 3])
def test_an_image_of_another_size_is_left_out(tmp_path: Path, odd: int) -> None:
    """Also the first one, as of a camera that begins in another mode."""
    small = np.zeros((24, 32), np.uint8).tobytes()
    stamp = layouts.STAMPS_NS[odd]
    path = write_log(
        tmp_path / "log.mcap",
        [
            (topic, replace(message, width=32, height=24, data=small))
            if isinstance(message, ImageMessage) and message.stamp_ns == stamp
            else (topic, message)
            for topic, message in layouts.log_messages()
        ],
    )
    source = open_source(path)
    kept = [frame.index for frame in source.frames()]
    assert kept == [number for number in range(layouts.COUNT) if number != odd]
