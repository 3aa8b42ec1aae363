"""Runs with wheel odometry: metres of one camera, and bytes that stay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores import ros2_humble as ros
from typer.testing import CliRunner
from wheels import BASE_IN_CAM, Wheels, write_csv

import vo
from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import inverse, make_transform, quat_xyzw_from_rotation, so3_exp
from vo.base.types import Floats, Trajectory
from vo.cli.app import app
from vo.recordings.formats.messages import (
    CalibrationMessage,
    FrameTransform,
    ImageMessage,
    TransformsMessage,
)
from vo.recordings.formats.ros2 import ROS2
from vo.recordings.formats.trajectory import read_tum

TABLES = ("trajectory.tum", "poses.csv", "covariance.csv", "causal.tum")
KITTI = "kitti07_mono_000-099"
CAM_FROM_BASE = make_transform(
    so3_exp(np.array([0.08, 0.0, 0.0])) @ BASE_IN_CAM, np.array([-0.3, 1.6, -1.5])
)


def summary(folder: Path) -> dict[str, Any]:
    found = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


def error_m(folder: Path, truth: Trajectory) -> float:
    """Root mean square after a rigid alignment."""
    found = read_tum(folder / "trajectory.tum")
    rows = np.isin(found.stamps_ns // 1000, truth.stamps_ns // 1000)
    known = np.isin(truth.stamps_ns // 1000, found.stamps_ns // 1000)
    aligned = umeyama(found.positions[rows], truth.positions[known], with_scale=False)
    off = aligned.transform_points(found.positions[rows]) - truth.positions[known]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def true_path(source: Path) -> Trajectory:
    truth = vo.open(source).ground_truth
    assert truth is not None
    return truth


def test_wheels_give_one_camera_its_metres(shared_data: Path, tmp_path: Path) -> None:
    """54 m; errors of 1 % in each sample, a slip of 2 s, a clock that is late by 0.1 s."""
    source = shared_data / KITTI
    truth = true_path(source)
    wheels = Wheels(late_s=0.1, slip_s=(4.0, 6.0))
    table = write_csv(tmp_path / "wheel.csv", truth, wheels)
    vo.run(source, tmp_path / "with", "fast", wheel=table)
    vo.run(source, tmp_path / "without", "fast")
    found = summary(tmp_path / "with")
    (scale,), (use,) = found["scales"], found["wheel"]
    assert scale["source"] == "wheel odometry" and found["length_unit"] == "m"
    assert 0.014 < scale["sigma"] / scale["value"] < 0.03
    assert use["offset_s"] == pytest.approx(0.1, abs=0.04) and 8 <= use["refused"] <= 14
    assert error_m(tmp_path / "with", truth) < 0.3
    causal = [(tmp_path / name / "causal.tum").read_bytes() for name in ("with", "without")]
    assert causal[0] == causal[1]


def test_wheels_of_another_drive_leave_every_byte(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / KITTI
    truth = true_path(source)
    other = Trajectory(truth.stamps_ns, truth.world_from_cam[::-1].copy())
    table = write_csv(tmp_path / "wheel.csv", other, Wheels())
    vo.run(source, tmp_path / "with", "fast", wheel=table)
    vo.run(source, tmp_path / "without", "fast")
    for name in TABLES:
        paths = [tmp_path / folder / name for folder in ("with", "without")]
        assert paths[0].read_bytes() == paths[1].read_bytes()
    told = [text for text in summary(tmp_path / "with")["warnings"] if "wheel" in text]
    assert len(told) == 1 and "left out" in told[0]


def test_a_stereo_path_tells_the_radius_and_keeps_its_bytes(
    shared_data: Path, tmp_path: Path
) -> None:
    source = shared_data / "kitti06_stereo_000-050"
    table = write_csv(tmp_path / "wheel.csv", true_path(source), Wheels(radius=1.05))
    vo.run(source, tmp_path / "with", "fast", wheel=table)
    vo.run(source, tmp_path / "without", "fast")
    for name in TABLES:
        paths = [tmp_path / folder / name for folder in ("with", "without")]
        assert paths[0].read_bytes() == paths[1].read_bytes()
    found = summary(tmp_path / "with")
    assert found["wheel"][0]["length_error"] == pytest.approx(0.05, abs=5e-3)
    assert any("check the wheel radius" in text for text in found["warnings"])


def write_log(path: Path, source: Path, moving: Floats) -> None:
    """Images of a recording, tf_static, and Odometry of base_link at the times of its images."""
    recording = vo.open(source)
    store = get_typestore(Stores.ROS2_HUMBLE)
    odometry = "nav_msgs/msg/Odometry"
    camera = recording.rig.cam0
    projection = np.column_stack([camera.matrix, np.zeros(3)])
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}

        def add(topic: str, name: str, definition: bytes, data: bytes, stamp_ns: int) -> None:
            if topic not in channels:
                schema = writer.register_schema(name, "ros2msg", definition)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], stamp_ns, data, stamp_ns)

        def add_own(topic: str, message: Any, stamp_ns: int) -> None:
            schema = ROS2.schema(type(message))
            add(topic, schema.name, schema.definition, ROS2.encode(message), stamp_ns)

        fixed = FrameTransform("base_link", "optical", inverse(CAM_FROM_BASE))
        for frame, pose in zip(recording.frames(), moving, strict=True):
            stamp_ns = int(frame.stamp_ns) + 10**9
            if frame.index == 0:
                add_own("/tf_static", TransformsMessage(stamp_ns, (fixed,)), stamp_ns)
            height, width = frame.images[0].shape
            calibration = CalibrationMessage(stamp_ns, "optical", camera, np.eye(3), projection)
            add_own("/camera/camera_info", calibration, stamp_ns)
            pixels = np.ascontiguousarray(frame.images[0]).tobytes()
            image = ImageMessage(stamp_ns, "optical", width, height, "mono8", pixels)
            add_own("/camera/image_raw", image, stamp_ns)
            text, _ = store.generate_msgdef(odometry)
            message = odometry_of(pose, stamp_ns)
            data = bytes(store.serialize_cdr(message, odometry))
            add("/odom", odometry, text.encode(), data, stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def odometry_of(pose: Floats, stamp_ns: int) -> ros.nav_msgs__msg__Odometry:
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    stamp = ros.builtin_interfaces__msg__Time(seconds, nanoseconds)
    zero = ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0)
    quaternion = map(float, quat_xyzw_from_rotation(pose[:3, :3]))
    placed = ros.geometry_msgs__msg__Pose(
        ros.geometry_msgs__msg__Point(*map(float, pose[:3, 3])),
        ros.geometry_msgs__msg__Quaternion(*quaternion),
    )
    return ros.nav_msgs__msg__Odometry(
        ros.std_msgs__msg__Header(stamp, "odom"),
        "base_link",
        ros.geometry_msgs__msg__PoseWithCovariance(placed, np.zeros(36)),
        ros.geometry_msgs__msg__TwistWithCovariance(
            ros.geometry_msgs__msg__Twist(zero, zero), np.zeros(36)
        ),
    )


def test_the_base_of_a_robot_by_tf_static(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / KITTI
    truth = true_path(source)
    base = truth.world_from_cam @ CAM_FROM_BASE
    motions = inverse(base[:-1]) @ base[1:]
    motions[:, :3, 3] *= 1.0 + np.random.default_rng(0).normal(0.0, 0.01, (len(motions), 1))
    moving = [np.eye(4)]
    for motion in motions:
        moving.append(moving[-1] @ motion)
    write_log(tmp_path / "robot.mcap", source, np.array(moving))
    result = CliRunner().invoke(
        app,
        ["run", str(tmp_path / "robot.mcap"), "-o", str(tmp_path / "out"), "--config", "fast"]
        + ["--wheel", "auto"],
    )
    assert result.exit_code == 0, result.output
    (use,) = summary(tmp_path / "out")["wheel"]
    assert use["arm_m"] is None and use["refused"] <= 3  # the lever arm is that of tf_static
    moved = Trajectory(truth.stamps_ns + 10**9, truth.world_from_cam)
    assert error_m(tmp_path / "out", moved) < 0.3


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("none.csv", "none.csv does not exist; give --wheel a file of wheel"),
        ("late.csv", "no wheel odometry during the recording"),
        ("auto", "has no wheel odometry; give a log or a table of speeds"),
    ],
)
def test_what_is_no_wheel_odometry_is_told_before_the_run(
    synthetic_stereo: Path, tmp_path: Path, given: str, message: str
) -> None:
    rows = "".join(f"{1e8 + 0.1 * number:.1f},1\n" for number in range(20))
    (tmp_path / "late.csv").write_text("time,speed\n" + rows)
    arguments = ["run", str(synthetic_stereo), "-o", str(tmp_path / "out")]
    named = given if given == "auto" else str(tmp_path / given)
    result = CliRunner().invoke(app, [*arguments, "--wheel", named])
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())
