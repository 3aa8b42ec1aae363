"""Which topics are the cameras, what they are, and what is said where that cannot be told."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import layouts
import numpy as np
import pytest
from mcap.writer import Writer
from mcap_logs import DIALECTS, write_log
from rosbags.typesys import Stores, get_typestore

from vo.errors import CalibrationError, SourceError
from vo.formats.messages import (
    CalibrationMessage,
    CompressedImageMessage,
    FrameTransform,
    ImageMessage,
    Message,
    PoseMessage,
    TransformsMessage,
)
from vo.geometry.transforms import inverse, se3_exp
from vo.sources.registry import open_source
from vo.types import Camera

OnTopic = tuple[str, Message]
LENS = Camera(
    layouts.WIDTH, layouts.HEIGHT, *layouts.INTRINSICS, "radtan", (0.05, -0.01, 0.001, 0.002, 0.0)
)
FISHEYE = replace(LENS, distortion_model="equidistant", distortion=(0.01, 0.02, 0.03, 0.04))
RATIONAL = replace(LENS, distortion=(0.05, -0.01, 0.001, 0.002, 0.0, 0.01, 0.02, 0.03))
CAM1_FROM_CAM0 = se3_exp(np.array([0.01, -0.02, 0.005, -0.12, 0.001, 0.002]))


def images(topic: str, frame: str = "cam", count: int = 4, every: int = 1) -> Iterator[OnTopic]:
    for stamp in layouts.STAMPS_NS[:count:every]:
        pixels = layouts.image(0).tobytes()
        size = layouts.WIDTH, layouts.HEIGHT
        yield topic, ImageMessage(stamp, frame, *size, "mono8", pixels)


def calibration(
    topic: str, frame: str, camera: Camera = LENS, shift: float = 0.0, turn: Any = None
) -> OnTopic:
    projection = np.column_stack([camera.matrix, [shift * camera.fx, 0, 0]])
    message = CalibrationMessage(
        layouts.STAMPS_NS[0], frame, camera, np.eye(3) if turn is None else turn, projection
    )
    return topic, message


def fixed(*transforms: tuple[str, str, Any]) -> OnTopic:
    message = TransformsMessage(1, tuple(FrameTransform(*each) for each in transforms))
    return "/tf_static", message


def log(tmp_path: Path, *parts: OnTopic | Iterable[OnTopic], dialect: str = "ros2") -> Path:
    messages: list[OnTopic] = []
    for part in parts:
        messages.extend([part] if isinstance(part, tuple) else part)  # type: ignore[list-item]
    return write_log(tmp_path / "log.mcap", messages, DIALECTS[dialect])


def stereo(tmp_path: Path, left: str, right: str, *more: OnTopic | Iterable[OnTopic]) -> Path:
    return log(
        tmp_path,
        images(left, "a"),
        images(right, "b"),
        calibration(f"{left.rpartition('/')[0]}/camera_info", "a"),
        calibration(f"{right.rpartition('/')[0]}/camera_info", "b"),
        fixed(("b", "a", CAM1_FROM_CAM0)),
        *more,
    )


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("/cam0/image_raw", "/cam1/image_raw"),
        ("/stereo/left/image_raw", "/stereo/right/image_raw"),
        ("/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw"),
        ("/kitti/image_0/data", "/kitti/image_1/data"),
        ("/front_left/image", "/front_right/image"),
        ("/port/image", "/starboard/image"),
    ],
)
@pytest.mark.parametrize("dialect", DIALECTS)
def test_left_and_right_are_known_by_their_names(
    tmp_path: Path, left: str, right: str, dialect: str
) -> None:
    path = log(
        tmp_path,
        images(right, "b"),
        images(left, "a"),
        calibration(f"{left.rpartition('/')[0]}/camera_info", "a"),
        calibration(f"{right.rpartition('/')[0]}/camera_info", "b"),
        fixed(("b", "a", CAM1_FROM_CAM0)),
        dialect=dialect,
    )
    rig = open_source(path).rig
    assert rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(rig.cam1_from_cam0, CAM1_FROM_CAM0, atol=1e-12)


def test_what_shows_no_view_and_other_cameras_do_not_disturb_a_pair(tmp_path: Path) -> None:
    path = stereo(
        tmp_path,
        "/camera/infra1/image_rect_raw",
        "/camera/infra2/image_rect_raw",
        images("/camera/depth/image_rect_raw"),
        images("/camera/color/image_raw"),
    )
    source = open_source(path)
    assert source.rig.is_stereo
    assert all(f.image1 is not None for f in source.frames())


def test_one_camera_alone(tmp_path: Path) -> None:
    path = log(tmp_path, images("/camera/image_raw", "c"), calibration("/camera/camera_info", "c"))
    source = open_source(path)
    assert (source.rig.cam0, source.rig.is_stereo) == (LENS, False)


def test_of_one_camera_what_was_not_compressed_is_taken(tmp_path: Path) -> None:
    raw = list(images("/camera/image_raw", "c"))
    jpeg = cv2.imencode(".jpg", layouts.image(0))[1].tobytes()
    path = log(
        tmp_path,
        [
            ("/camera/image_raw/compressed", CompressedImageMessage(m.stamp_ns, "c", "jpeg", jpeg))
            for _, m in raw
        ],
        raw,
        calibration("/camera/camera_info", "c"),
    )
    frame = next(open_source(path).frames())
    assert np.array_equal(frame.image0, layouts.image(0))


@pytest.mark.parametrize(
    "text", ["jpeg", "bgr8; jpeg compressed bgr8", "mono8; png compressed ", ""]
)
def test_compressed_images_are_known_by_their_content(tmp_path: Path, text: str) -> None:
    kind = ".png" if "png" in text else ".jpg"
    smooth = cv2.GaussianBlur(layouts.image(0), (0, 0), 5)
    data = cv2.imencode(kind, smooth)[1].tobytes()
    path = log(
        tmp_path,
        [
            ("/camera/image_raw/compressed", CompressedImageMessage(stamp, "c", text, data))
            for stamp in layouts.STAMPS_NS
        ],
        calibration("/camera/camera_info", "c"),
    )
    frame = next(open_source(path).frames())
    assert np.abs(frame.image0.astype(int) - smooth).max() <= 6


def test_several_cameras_are_listed_with_what_to_type(tmp_path: Path) -> None:
    path = log(
        tmp_path,
        images("/front/image_raw", count=6),
        images("/rear/image_raw", count=3),
        images("/top/image_raw"),
    )
    with pytest.raises(SourceError) as caught:
        open_source(path)
    lines = str(caught.value).splitlines()
    assert "which of 3 cameras?" in lines[0]
    assert "--topic left=/front/image_raw --topic right=/rear/image_raw" in lines[0]
    assert [line.split() for line in lines[1:]] == [
        ["/front/image_raw", "sensor_msgs/msg/Image", "6", "messages", "10.0", "Hz"],
        ["/rear/image_raw", "sensor_msgs/msg/Image", "3", "messages", "4.0", "Hz"],
        ["/top/image_raw", "sensor_msgs/msg/Image", "4", "messages", "6.0", "Hz"],
    ]


def test_topics_can_be_chosen(tmp_path: Path) -> None:
    path = stereo(
        tmp_path,
        "/front/image_raw",
        "/rear/image_raw",
        images("/top/image_raw", "c"),
        calibration("/top/camera_info", "c", FISHEYE),
    )
    pair = open_source(path, topics=["left=/front/image_raw", "right=/rear/image_raw"])
    assert pair.rig.is_stereo
    turned = open_source(path, topics=["right=front/image_raw", "left=rear/image_raw"])
    assert turned.rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(turned.rig.cam1_from_cam0, inverse(CAM1_FROM_CAM0), atol=1e-12)
    single = open_source(path, topics=["/top/image_raw"])
    assert (single.rig.cam0, single.rig.is_stereo) == (FISHEYE, False)


@pytest.mark.parametrize(
    ("wishes", "reason"),
    [
        (
            ["/front/image_row"],
            "there is no topic /front/image_row; did you mean /front/image_raw?",
        ),
        (["middle=/front/image_raw"], "--topic middle=/front/image_raw is invalid"),
        (["right=/front/image_raw"], "requires --topic left="),
        (["/front/image_raw", "left=/rear/image_raw"], "gives two topics for left"),
        (["left="], "is invalid"),
    ],
)
def test_wrong_choices(tmp_path: Path, wishes: list[str], reason: str) -> None:
    path = log(tmp_path, images("/front/image_raw"), images("/rear/image_raw", count=1))
    with pytest.raises(SourceError, match=reason):
        open_source(path, topics=wishes)


def test_a_folder_has_no_topics(tmp_path: Path) -> None:
    layouts.write_folder(tmp_path / "folder")
    with pytest.raises(SourceError, match=r"\(folder\) has no topics; leave --topic out"):
        open_source(tmp_path / "folder", topics=["/a"])


def test_no_images(tmp_path: Path) -> None:
    path = log(tmp_path, calibration("/camera/camera_info", "c"))
    with pytest.raises(SourceError, match="no topic has images of a known type; topics:\n.*info"):
        open_source(path)


@pytest.mark.parametrize(
    "lens", [LENS, FISHEYE, RATIONAL, replace(LENS, distortion_model="none", distortion=())]
)
@pytest.mark.parametrize("dialect", DIALECTS)
def test_lenses_are_read_as_they_were_written(tmp_path: Path, lens: Camera, dialect: str) -> None:
    parts = images("/camera/image", "c"), calibration("/camera/camera_info", "c", lens)
    assert open_source(log(tmp_path, *parts, dialect=dialect)).rig.cam0 == lens


def test_calibrations_elsewhere_are_known_by_their_frame(tmp_path: Path) -> None:
    path = log(
        tmp_path,
        images("/camera/image", "optical"),
        calibration("/somewhere/else", "other", FISHEYE),
        calibration("/calibrations/front", "optical"),
    )
    assert open_source(path).rig.cam0 == LENS


def test_no_calibration_names_those_there_are(tmp_path: Path) -> None:
    path = log(tmp_path, images("/camera/image", "a"), calibration("/other/camera_info", "b"))
    with pytest.raises(CalibrationError) as caught:
        open_source(path)
    assert "no calibration for /camera/image" in str(caught.value)
    assert "/other/camera_info" in str(caught.value)
    assert "--calibration FILE" in str(caught.value)
    layouts.write_text(tmp_path / "mine.yaml", layouts.CALIBRATION)
    rig = open_source(path, calibration=tmp_path / "mine.yaml").rig
    assert rig.cam0.fx == layouts.INTRINSICS[0]


def test_the_baseline_is_found_through_frames_between(tmp_path: Path) -> None:
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


def test_frames_that_move_do_not_count(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
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


def test_the_baseline_is_found_in_the_rectification(tmp_path: Path) -> None:
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


def test_rectified_images_have_the_rectified_camera(tmp_path: Path) -> None:
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


@pytest.mark.parametrize("chained", [True, False])
def test_truth_is_carried_to_the_camera(
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


def test_messages_without_a_stamp_have_the_time_of_logging(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    parts = [("/camera/image", replace(m, stamp_ns=0)) for _, m in images("/camera/image", "c")]
    times = iter(range(1000, 100_000, 1000))
    path = write_log(
        tmp_path / "log.mcap",
        [calibration("/camera/camera_info", "c"), *parts],
        log_ns=lambda _: next(times),
    )
    assert [f.stamp_ns for f in open_source(path).frames()] == [2000, 3000, 4000, 5000]
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
def test_depth_at_the_pixels_of_the_camera_is_used(tmp_path: Path, form: str) -> None:
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


def test_depth_of_another_frame_is_left_alone(tmp_path: Path) -> None:
    path = log(
        tmp_path,
        images("/camera/color/image_raw", "color"),
        depth("/camera/depth/image_rect_raw", "depth", "16UC1"),
        calibration("/camera/color/camera_info", "color"),
    )
    assert not open_source(path).rig.has_depth


def test_cameras_that_look_apart_are_no_pair(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = log(
        tmp_path,
        images("/front/image", "a"),
        images("/rear/image", "b"),
        calibration("/front/camera_info", "a"),
        calibration("/rear/camera_info", "b"),
        fixed(("b", "a", se3_exp(np.array([0, np.pi * 0.9, 0, 0.1, 0, 0])))),
    )
    assert not open_source(path).rig.is_stereo
    first, second = (record.getMessage() for record in caplog.records)
    assert "/front/image is used as the left camera and /rear/image as the right one" in first
    assert "differ by 162 degrees, too much for a stereo pair" in second
