"""Wheel odometry as robots and programs write it, and its fit to a path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores import ros2_humble as ros
from wheels import Wheels, arc_path, posed, write_csv

from vo.base.errors import SourceError
from vo.runs.scaling.wheel_fit import WheelFit, fit_wheel, make_steps
from vo.runs.scaling.wheel_odometry import read_wheel

START_NS = 1_700_000_000_000_000_000
ODOMETRY = "nav_msgs/msg/Odometry"
TWIST = "geometry_msgs/msg/TwistStamped"
WITH_COVARIANCE = "geometry_msgs/msg/TwistWithCovarianceStamped"
STORE = get_typestore(Stores.ROS2_HUMBLE)


def header(stamp_ns: int, frame: str) -> ros.std_msgs__msg__Header:
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(seconds, nanoseconds), frame)


def twist(speed: float, yaw_rate: float) -> ros.geometry_msgs__msg__Twist:
    vector = ros.geometry_msgs__msg__Vector3
    return ros.geometry_msgs__msg__Twist(vector(speed, 0.0, 0.0), vector(0.0, 0.0, yaw_rate))


def message(kind: str, number: int, *, poses_move: bool = True) -> tuple[int, Any]:
    """1 m/s and 0.1 rad/s, at 10 Hz."""
    stamp_ns, time = START_NS + number * 10**8, 0.1 * number
    moving = twist(1.0, 0.1)
    if kind == TWIST:
        return stamp_ns, ros.geometry_msgs__msg__TwistStamped(header(stamp_ns, "base_link"), moving)
    covered = ros.geometry_msgs__msg__TwistWithCovariance(moving, np.zeros(36))
    if kind == WITH_COVARIANCE:
        head = header(stamp_ns, "base_link")
        return stamp_ns, ros.geometry_msgs__msg__TwistWithCovarianceStamped(head, covered)
    angle = 0.1 * time if poses_move else 0.0
    x, y = 10.0 * np.sin(angle), 10.0 * (1.0 - np.cos(angle))
    pose = ros.geometry_msgs__msg__Pose(
        ros.geometry_msgs__msg__Point(float(x), float(y), 0.0),
        ros.geometry_msgs__msg__Quaternion(
            0.0, 0.0, float(np.sin(0.5 * angle)), float(np.cos(0.5 * angle))
        ),
    )
    with_covariance = ros.geometry_msgs__msg__PoseWithCovariance(pose, np.zeros(36))
    head = header(stamp_ns, "odom")
    return stamp_ns, ros.nav_msgs__msg__Odometry(head, "base_link", with_covariance, covered)


def write_log(path: Path, topics: dict[str, str], **given: bool) -> Path:
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        for topic, kind in topics.items():
            definition, _ = STORE.generate_msgdef(kind)
            schema = writer.register_schema(kind, "ros2msg", definition.encode())
            channel = writer.register_channel(topic, "cdr", schema)
            for number in range(41):
                stamp_ns, found = message(kind, number, **given)
                data = bytes(STORE.serialize_cdr(found, kind))
                writer.add_message(channel, stamp_ns, data, stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


@pytest.mark.parametrize("kind", [ODOMETRY, TWIST, WITH_COVARIANCE])
@pytest.mark.parametrize("poses_move", [True, False])
def test_messages_of_ros(tmp_path: Path, kind: str, poses_move: bool) -> None:
    log = write_log(tmp_path / "a.mcap", {"/wheel": kind}, poses_move=poses_move)
    for given, recording in ((str(log), None), ("auto:/wheel", str(log))):
        found = read_wheel(given, recording)
        np.testing.assert_allclose(found.way_m, 0.1 * np.arange(41), atol=1e-9)
        assert found.heading_rad is not None and found.xy_m is not None
        np.testing.assert_allclose(found.heading_rad[-1], 0.4, atol=1e-9)
        end = 10.0 * np.sin(0.4), 10.0 * (1.0 - np.cos(0.4))
        np.testing.assert_allclose(found.xy_m[-1], end, atol=1e-9)
        values, parts = found.at(np.array([START_NS - 1, START_NS + 150_000_000]))
        assert parts.tolist() == [-1, 0] and values[1, 0] == pytest.approx(0.15)


def test_one_topic_is_chosen_or_named(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap", {"/odom": ODOMETRY, "/twist": TWIST})
    assert read_wheel(str(log), None).name.startswith("/odom")
    two = write_log(tmp_path / "b.mcap", {"/left": TWIST, "/right": TWIST})
    with pytest.raises(SourceError, match=r"on /left, /right; choose one: `wheel=.*:/left`"):
        read_wheel(str(two), None)
    with pytest.raises(SourceError, match="no wheel odometry on /none; it has /left, /right"):
        read_wheel(f"{two}:/none", None)


def test_tables_of_speeds_and_poses(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,speed\n" + "".join(f"{0.1 * n:.1f},2\n" for n in range(30)))
    found = read_wheel(str(path), None)
    assert found.heading_rad is None and found.way_m[-1] == pytest.approx(5.8)
    path.write_text("time,speed\n" + "".join(f"{n},2\n" for n in (*range(20), *range(60, 80))))
    assert read_wheel(str(path), None).parts.max() == 1  # 40 s without samples
    rows = "".join(f"{0.1 * n:.1f} {0.2 * n:.2f} 0 0 0 0 0 1\n" for n in range(30))
    (tmp_path / "a.tum").write_text(rows)
    assert read_wheel(str(tmp_path / "a.tum"), None).way_m[-1] == pytest.approx(5.8)
    camera = "".join(f"{0.1 * n:.1f} 0 0 {0.2 * n:.2f} 0 0 0 1\n" for n in range(30))
    (tmp_path / "c.tum").write_text(camera)  # z ahead
    assert read_wheel(str(tmp_path / "c.tum"), None).way_m[-1] == pytest.approx(5.8)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "time,speed\n1,2\n", "1 samples of wheel odometry; give at least ten"),
        ("b.csv", "time,speed\n1,fast\n", "b.csv:2"),
        ("c.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "give a CSV with `stamp` and `speed`"),
    ],
)
def test_bad_files(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SourceError, match=message):
        read_wheel(str(tmp_path / name), None)
    with pytest.raises(SourceError, match="does not exist; give `wheel` a file of wheel"):
        read_wheel(str(tmp_path / "none.csv"), None)


def fitted(tmp_path: Path, wheels: Wheels, scale: float = 1.0) -> WheelFit:
    path = arc_path(60.0, arm_m=wheels.arm_m)
    write_csv(tmp_path / "w.csv", path, wheels)
    wheel = read_wheel(str(tmp_path / "w.csv"), None)
    found = fit_wheel(make_steps(posed(path, scale), 0, wheel), wheel)
    assert isinstance(found, WheelFit)
    return found


def test_exact_wheels_give_scale_and_lever_arm(tmp_path: Path) -> None:
    found = fitted(tmp_path, Wheels(noise=0.0, arm_m=(1.0, 0.5)), 4.0)
    assert found.scale == pytest.approx(4.0, rel=2e-4)
    np.testing.assert_allclose(found.arm_m, (1.0, 0.5), atol=5e-3)
    assert found.sigma < 5e-4 * found.scale and not len(found.slips_ns)
    np.testing.assert_allclose(found.cam0_from_base[:3, 0], (0.0, 0.0, 1.0), atol=6e-3)


def test_faults_of_wheels_are_found(tmp_path: Path) -> None:
    wheels = Wheels(noise=0.01, radius=1.02, late_s=0.1, arm_m=(1.0, 0.5), slip_s=(20.0, 22.0))
    found = fitted(tmp_path, wheels)
    assert found.scale == pytest.approx(1.02, abs=2e-3)
    assert found.offset_s == pytest.approx(0.1, abs=0.011)
    slips_s = 1e-9 * (found.slips_ns - found.slips_ns.min())
    assert 1.5 < np.ptp(slips_s) < 3.0 and found.used > 250
    np.testing.assert_allclose(found.arm_m, (1.0, 0.5), atol=0.05)


def test_speed_without_turns_says_nothing_of_arm_and_clock(tmp_path: Path) -> None:
    path = arc_path(20.0, turning=0.0, changing=0.0)
    write_csv(tmp_path / "w.csv", path, Wheels(late_s=0.1))
    wheel = read_wheel(str(tmp_path / "w.csv"), None)
    found = fit_wheel(make_steps(posed(path), 0, wheel), wheel)
    assert isinstance(found, WheelFit)
    assert found.offset_s == 0.0 and not found.has_up
    assert found.scale == pytest.approx(1.0, abs=3e-3)
