"""The ROS 2 example node, run on a recording with a stand-in for ROS."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import ros2_stand_in as ros

import vo
from vo.base.geometry.transforms import (
    inverse,
    make_transform,
    quat_xyzw_from_rotation,
    rotation_from_quat_xyzw,
    se3_exp,
    so3_exp,
)
from vo.base.types import KeyframePose

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "ros2"
FRAMES = 6
CAMERA_FRAME = "left_camera_optical_frame"
# A camera 0.3 m in front of the robot's centre, 0.5 m high, looking 20 degrees down.
BASE_FROM_CAM0 = make_transform(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    @ so3_exp(np.array([np.radians(-20.0), 0.0, 0.0])),
    np.array([0.3, 0.0, 0.5]),
)


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module of the node, imported with the stand-in."""
    for name, module in ros.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    for name in ("visual_odometry_node", "ros_conversions"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setattr(ros.Buffer, "known", {})
    yield importlib.import_module("visual_odometry_node")


@pytest.fixture
def conversions(example: ModuleType) -> ModuleType:
    return importlib.import_module("ros_conversions")


def node_of(example: ModuleType, **parameters: Any) -> Any:
    overrides = [ros.Parameter(name, value=value) for name, value in parameters.items()]
    return example.VisualOdometryNode(parameter_overrides=overrides)


def header_of(message: Any, stamp_ns: int, frame: str) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.header.frame_id = frame


def image_message(pixels: np.ndarray, stamp_ns: int, encoding: str = "mono8", pad: int = 5) -> Any:
    """An image with `pad` unused bytes at the end of each row."""
    message = ros.message("sensor_msgs/msg/Image")
    header_of(message, stamp_ns, CAMERA_FRAME)
    message.height, message.width = pixels.shape[:2]
    rows = np.pad(pixels.reshape(len(pixels), -1), ((0, 0), (0, pad)))
    message.encoding, message.step = encoding, rows.shape[1]
    message.data = rows.tobytes()
    return message


def camera_info(camera: vo.Camera, baseline_m: float = 0.0) -> Any:
    message = ros.message("sensor_msgs/msg/CameraInfo")
    header_of(message, 0, CAMERA_FRAME)
    message.width, message.height = camera.width, camera.height
    message.distortion_model = "plumb_bob"
    message.d = list(camera.distortion) or [0.0] * 5
    message.k = camera.matrix.ravel()
    message.r = np.eye(3).ravel()
    projection = np.column_stack([camera.matrix, [-camera.fx * baseline_m, 0.0, 0.0]])
    message.p = projection.ravel()
    return message


def mounted(base: str = "base_link") -> None:
    found = ros.message("geometry_msgs/msg/TransformStamped")
    t, q = found.transform.translation, found.transform.rotation
    t.x, t.y, t.z = BASE_FROM_CAM0[:3, 3].tolist()
    q.x, q.y, q.z, q.w = quat_xyzw_from_rotation(BASE_FROM_CAM0[:3, :3]).tolist()
    ros.Buffer.known = {(base, CAMERA_FRAME): found}


def pose_of(odometry: Any) -> np.ndarray:
    pose = odometry.pose.pose
    p, q = pose.position, pose.orientation
    rotation = rotation_from_quat_xyzw(np.array([q.x, q.y, q.z, q.w]))
    return make_transform(rotation, np.array([p.x, p.y, p.z]))


def play(node: Any, recording: Any, *, frames: int = FRAMES, right_late_ns: int = 0) -> list[Any]:
    """Publish a stereo recording, the right images first; the frames that were published."""
    played = []
    for frame in recording.frames(0, frames):
        stamp_ns = frame.stamp_ns
        node.deliver("right/image", image_message(frame.image1, stamp_ns + right_late_ns))
        node.deliver("left/image", image_message(frame.image0, stamp_ns))
        played.append(frame)
    return played


def publish_cameras(node: Any, rig: vo.Rig) -> None:
    assert rig.cam1_from_cam0 is not None and rig.cam1 is not None
    node.deliver("left/camera_info", camera_info(rig.cam0))
    baseline_m = -float(rig.cam1_from_cam0[0, 3])
    node.deliver("right/camera_info", camera_info(rig.cam1, baseline_m))


def test_odometry_and_tf_are_the_path_of_the_library(
    example: ModuleType, synthetic_stereo: Path
) -> None:
    recording = vo.open(synthetic_stereo)
    with vo.Odometry(recording.rig, config="fast") as odometry:
        expected = [
            odometry.track(f.stamp_ns, f.image0, f.image1) for f in recording.frames(0, FRAMES)
        ]
    node = node_of(example, config="fast")
    mounted()
    publish_cameras(node, recording.rig)
    play(node, recording, right_late_ns=1_000_000)
    messages = node.published["odom"].messages
    assert len(messages) == FRAMES
    for message, estimate in zip(messages, expected, strict=True):
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
        stamp = message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == estimate.stamp_ns
        pose = BASE_FROM_CAM0 @ estimate.world_from_cam0 @ inverse(BASE_FROM_CAM0)
        assert np.allclose(pose_of(message), pose, atol=1e-9)
        covariance = message.pose.covariance.reshape(6, 6)
        assert np.allclose(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert np.allclose(pose_of(messages[0]), np.eye(4), atol=1e-9)
    sent = node.published["/tf"].messages
    for message, (transform,) in zip(messages, (each.transforms for each in sent), strict=True):
        assert transform.header.frame_id == "odom"
        assert transform.child_frame_id == "base_link"
        assert transform.transform.translation.x == message.pose.pose.position.x
        assert transform.transform.rotation is message.pose.pose.orientation
    twist, now, before = messages[-1].twist.twist, pose_of(messages[-1]), pose_of(messages[-2])
    seconds = 1e-9 * (expected[-1].stamp_ns - expected[-2].stamp_ns)
    velocity = np.array([twist.linear.x, twist.linear.y, twist.linear.z])
    assert np.allclose(now[:3, :3] @ velocity * seconds, now[:3, 3] - before[:3, 3])
    turned = np.array([twist.angular.x, twist.angular.y, twist.angular.z]) * seconds
    assert np.allclose(before[:3, :3] @ so3_exp(turned), now[:3, :3])
    node.destroy_node()
    assert node.is_destroyed


def test_it_waits_for_cameras_and_mounting_and_says_so(
    example: ModuleType, synthetic_stereo: Path
) -> None:
    recording = vo.open(synthetic_stereo)
    node = node_of(example, config="fast")
    play(node, recording, frames=1)
    mounted()
    play(node, recording, frames=1)
    assert node.published["odom"].messages == []
    words = " ".join(text for _, text in node.get_logger().lines)
    assert f"waiting for the transform from base_link to {CAMERA_FRAME}" in words
    assert "waiting for left/camera_info" in words
    publish_cameras(node, recording.rig)
    play(node, recording, frames=2)
    assert len(node.published["odom"].messages) == 2
    node.destroy_node()


def test_without_a_base_frame_the_child_is_the_camera(
    example: ModuleType, synthetic_stereo: Path
) -> None:
    recording = vo.open(synthetic_stereo)
    node = node_of(example, config="fast", base_frame="", publish_tf=False)
    publish_cameras(node, recording.rig)
    play(node, recording, frames=3)
    messages = node.published["odom"].messages
    assert {message.child_frame_id for message in messages} == {CAMERA_FRAME}
    # The camera looks along the x axis of odom at the start, with its x axis to the right.
    assert np.allclose(pose_of(messages[0])[:3, 2], [1.0, 0.0, 0.0], atol=1e-9)
    assert np.allclose(pose_of(messages[0])[:3, 0], [0.0, -1.0, 0.0], atol=1e-9)
    assert node.published["/tf"].messages == []
    node.destroy_node()


def test_bad_input_is_a_line_of_the_log_and_the_node_goes_on(
    example: ModuleType, synthetic_stereo: Path
) -> None:
    recording = vo.open(synthetic_stereo)
    node = node_of(example, config="fast", base_frame="")
    publish_cameras(node, recording.rig)
    first, second = list(recording.frames(0, 2))
    play(node, recording, frames=1)
    for stamp_ns, encoding in ((first.stamp_ns, "mono8"), (second.stamp_ns, "yuv422")):
        node.deliver("right/image", image_message(first.image1, stamp_ns, encoding))
        node.deliver("left/image", image_message(first.image0, stamp_ns, encoding))
    errors = [text for severity, text in node.get_logger().lines if severity == "error"]
    assert len(errors) == 2
    assert "yuv422" in errors[1]
    node.deliver("right/image", image_message(second.image1, second.stamp_ns + 1))
    node.deliver("left/image", image_message(second.image0, second.stamp_ns + 1))
    assert len(node.published["odom"].messages) == 2
    node.destroy_node()


def test_one_camera(example: ModuleType, synthetic_stereo: Path) -> None:
    recording = vo.open(synthetic_stereo, mode="mono")
    node = node_of(example, config="fast", base_frame="", stereo=False)
    node.deliver("left/camera_info", camera_info(recording.rig.cam0))
    for frame in recording.frames(0, 12):
        colour = np.repeat(frame.image0[:, :, None], 3, axis=2)
        node.deliver("left/image", image_message(colour, frame.stamp_ns, "rgb8"))
    lines = node.get_logger().lines
    assert ("warning", "one camera alone: lengths are not in metres") in lines
    assert ("warning", "no pose: starting") in lines
    assert node.published["odom"].messages
    node.destroy_node()


def test_the_program_ends_with_ros(example: ModuleType) -> None:
    example.main()


# --- conversions ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("encoding", "channels"), [("mono8", [0]), ("bgr8", [0, 1, 2]), ("rgba8", [2, 1, 0, 3])]
)
def test_images_become_blue_green_red(
    conversions: ModuleType, encoding: str, channels: list[int]
) -> None:
    bgra = np.random.default_rng(0).integers(0, 256, (7, 9, 4), dtype=np.uint8)
    message = image_message(bgra[:, :, channels], 0, encoding)
    expected = bgra[:, :, 0] if encoding == "mono8" else bgra[:, :, :3]
    assert np.array_equal(conversions.image_array(message), expected)


def test_cameras_come_from_camera_info(conversions: ModuleType) -> None:
    turns = [so3_exp(np.array([0.01, -0.02, 0.005])), so3_exp(np.array([-0.02, 0.03, 0.01]))]
    camera = vo.Camera(640, 480, 400.0, 410.0, 320.0, 240.0, "radtan", (-0.3, 0.1, 0.0, 0.0, 0.0))
    left, right = camera_info(camera), camera_info(camera, baseline_m=0.12)
    left.r, right.r = turns[0].ravel(), turns[1].ravel()
    rig = conversions.rig_from_camera_info(left, right, rectified=False)
    assert rig.cam0 == camera
    # Both rectified cameras see a point in the same row, the right one further left.
    point = np.array([0.5, -0.2, 3.0])
    other = rig.cam1_from_cam0[:3, :3] @ point + rig.cam1_from_cam0[:3, 3]
    assert np.allclose(turns[1] @ other, turns[0] @ point - [0.12, 0.0, 0.0])
    flat = conversions.rig_from_camera_info(left, right, rectified=True)
    assert flat.cam0.distortion_model == "none"
    assert np.allclose(flat.cam1_from_cam0, make_transform(np.eye(3), [-0.12, 0.0, 0.0]))
    assert conversions.rig_from_camera_info(left, None, rectified=False).cam1 is None


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"k": np.zeros(9)}, "is empty"),
        ({"binning_x": 2}, "binned or cropped"),
        ({"distortion_model": "fov"}, "is fov"),
    ],
)
def test_other_cameras_are_refused(
    conversions: ModuleType, changes: dict[str, Any], complaint: str
) -> None:
    info = camera_info(vo.Camera(640, 480, 400.0, 400.0, 320.0, 240.0))
    for name, value in changes.items():
        setattr(info, name, value)
    with pytest.raises(vo.VoError, match=complaint):
        conversions.rig_from_camera_info(info, None, rectified=False)
    other = camera_info(vo.Camera(640, 480, 400.0, 400.0, 320.0, 240.0))
    with pytest.raises(vo.VoError, match="baseline"):
        conversions.rig_from_camera_info(other, other, rectified=True)


def test_the_covariance_is_that_of_errors_in_the_axes_of_odom(conversions: ModuleType) -> None:
    rng = np.random.default_rng(3)
    half = rng.normal(size=(6, 6)) * 1e-3
    covariance = half @ half.T
    keyframe_pose = make_transform(so3_exp(np.array([0.3, -0.5, 0.2])), np.array([2.0, 1.0, 5.0]))
    motion = make_transform(so3_exp(np.array([0.05, 0.02, 0.1])), np.array([0.2, 0.1, 0.4]))
    keyframe = KeyframePose(0, 0, 0, keyframe_pose, covariance)
    now = keyframe_pose @ motion
    pose = conversions.odom_from_base(now, BASE_FROM_CAM0)

    drawn = rng.multivariate_normal(np.zeros(6), covariance, size=4_000)
    errors = []
    for xi in drawn:
        true = conversions.odom_from_base(keyframe_pose @ se3_exp(xi) @ motion, BASE_FROM_CAM0)
        turned = conversions.rotation_vector(true[:3, :3] @ pose[:3, :3].T)  # about odom's axes
        errors.append([*(true[:3, 3] - pose[:3, 3]), *turned])
    sampled = np.cov(np.array(errors).T)
    found = conversions.pose_covariance(keyframe, now, BASE_FROM_CAM0)
    found -= np.diag(conversions.FRAME_VARIANCE)
    scale = np.sqrt(np.diag(found))
    assert np.abs((sampled - found) / np.outer(scale, scale)).max() < 0.08


def test_an_unknown_covariance_is_large(conversions: ModuleType) -> None:
    found = conversions.pose_covariance(None, np.eye(4), np.eye(4))
    assert np.array_equal(found, np.eye(6) * 1e4)
