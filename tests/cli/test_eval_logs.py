"""`vo eval` and `vo info` of logs with poses and no images, written by rosbags."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from typer.testing import CliRunner, Result

from vo.base.geometry.transforms import inverse, quat_xyzw_from_rotation, se3_exp
from vo.base.types import Floats, Trajectory
from vo.cli.app import app
from vo.recordings.formats.trajectory import write_tum

COUNT = 40
STAMPS_NS = [1_600_000_000_000_000_000 + i * 100_000_000 for i in range(COUNT)]
POSES = np.array(
    [se3_exp(np.array([0.01 * i, 0.02 * i, 0.005 * i, 0.1 * i, np.sin(0.2 * i), 0.02 * i]))
     for i in range(COUNT)]
)  # fmt: skip
ODOM_FROM_BASE = np.array(
    [se3_exp(np.array([0, 0, 0.03 * i, 0.1 * i, 0, 0])) for i in range(COUNT)]
)
KINDS = ["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry", "Path"]


class Messages:
    """Makes messages of ROS 1 or ROS 2."""

    def __init__(self, store: Stores) -> None:
        self.store = get_typestore(store)
        if store is Stores.ROS1_NOETIC:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        self.types = self.store.types

    def header(self, stamp_ns: int, frame: str) -> Any:
        time = self.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        kind = self.types["std_msgs/msg/Header"]
        if "seq" in kind.__dataclass_fields__:
            return kind(seq=0, stamp=time, frame_id=frame)
        return kind(stamp=time, frame_id=frame)

    def geometry(self, pose: Floats, kind: str) -> Any:
        names = {"Pose": "Point", "Transform": "Vector3"}
        position = self.types[f"geometry_msgs/msg/{names[kind]}"](*pose[:3, 3].tolist())
        turn = self.types["geometry_msgs/msg/Quaternion"](
            *quat_xyzw_from_rotation(pose[:3, :3]).tolist()
        )
        return self.types[f"geometry_msgs/msg/{kind}"](position, turn)

    def transform(self, stamp_ns: int, parent: str, child: str, pose: Floats) -> Any:
        return self.types["geometry_msgs/msg/TransformStamped"](
            self.header(stamp_ns, parent), child, self.geometry(pose, "Transform")
        )

    def transforms(self, *transforms: Any) -> tuple[str, Any]:
        return "tf2_msgs/msg/TFMessage", self.types["tf2_msgs/msg/TFMessage"](list(transforms))

    def pose(self, kind: str, stamp_ns: int, pose: Floats) -> tuple[str, Any]:
        """The type of a message, and the message."""
        if kind == "TransformStamped":
            message = self.transform(stamp_ns, "map", "base", pose)
            return "geometry_msgs/msg/TransformStamped", message
        header, inner = self.header(stamp_ns, "map"), self.geometry(pose, "Pose")
        if kind == "PoseStamped":
            name = "geometry_msgs/msg/PoseStamped"
            return name, self.types[name](header, inner)
        both = self.types["geometry_msgs/msg/PoseWithCovariance"](inner, np.zeros(36))
        if kind == "PoseWithCovarianceStamped":
            name = "geometry_msgs/msg/PoseWithCovarianceStamped"
            return name, self.types[name](header, both)
        zero = self.types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        twist = self.types["geometry_msgs/msg/Twist"](zero, zero)
        speed = self.types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36))
        name = "nav_msgs/msg/Odometry"
        return name, self.types[name](header, "base", both, speed)

    def path(self, number: int, window: int = COUNT) -> tuple[str, Any]:
        """A path up to a pose, as it is published while it grows."""
        poses = [
            self.pose("PoseStamped", STAMPS_NS[i], POSES[i])[1]
            for i in range(max(0, number + 1 - window), number + 1)
        ]
        name = "nav_msgs/msg/Path"
        return name, self.types[name](self.header(STAMPS_NS[number], "map"), poses)


Logged = Iterator[tuple[str, int, tuple[str, Any]]]


def write_log(folder: Path, layout: str, messages: Messages, logged: Logged) -> Path:
    """Write messages as `rosbag1`, `sqlite` or `mcap`."""
    if layout == "rosbag1":
        writer: Any = Rosbag1Writer(folder / "log.bag")
    else:
        plugin = StoragePlugin.SQLITE3 if layout == "sqlite" else StoragePlugin.MCAP
        writer = Rosbag2Writer(folder / "log", version=9, storage_plugin=plugin)
    is_ros1 = layout == "rosbag1"
    with writer:
        connections: dict[str, Any] = {}
        for topic, stamp_ns, (kind, message) in logged:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            store = messages.store
            encode = store.serialize_ros1 if is_ros1 else store.serialize_cdr
            writer.write(connections[topic], stamp_ns, bytes(encode(message, kind)))
    return folder / ("log.bag" if is_ros1 else "log")


def poses(messages: Messages, topic: str, kind: str) -> Logged:
    for i, stamp_ns in enumerate(STAMPS_NS):
        made = messages.path(i) if kind == "Path" else messages.pose(kind, stamp_ns, POSES[i])
        yield topic, stamp_ns, made


def frames(messages: Messages) -> Logged:
    """map to odom at 5 Hz, odom to base at 10 Hz, and a sensor fixed to base."""
    sensor = messages.transform(STAMPS_NS[0], "base", "sensor", np.eye(4))
    yield "/tf_static", STAMPS_NS[0], messages.transforms(sensor)
    for i, stamp_ns in enumerate(STAMPS_NS):
        moved = [messages.transform(stamp_ns, "odom", "base", ODOM_FROM_BASE[i])]
        if i % 2 == 0 or i == COUNT - 1:
            map_from_odom = POSES[i] @ inverse(ODOM_FROM_BASE[i])
            moved.append(messages.transform(stamp_ns, "map", "odom", map_from_odom))
        yield "/tf", stamp_ns, messages.transforms(*moved)


@pytest.fixture
def trajectory(tmp_path: Path) -> Path:
    write_tum(tmp_path / "poses.tum", Trajectory(np.array(STAMPS_NS), POSES))
    return tmp_path / "poses.tum"


def vo(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def errors(*arguments: object) -> tuple[float, int, list[str]]:
    """ATE in metres without alignment, number of matched poses, and notes."""
    result = vo("eval", *arguments, "--align", "none", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    return found["ate"]["translation_m"]["max"], found["matched"], found["notes"]


def messages_for(layout: str) -> Messages:
    return Messages(Stores.ROS1_NOETIC if layout == "rosbag1" else Stores.ROS2_HUMBLE)


@pytest.mark.parametrize("layout", ["rosbag1", "sqlite", "mcap"])
@pytest.mark.parametrize("kind", KINDS)
def test_poses_of_a_log_on_both_sides(
    tmp_path: Path, trajectory: Path, layout: str, kind: str
) -> None:
    messages = messages_for(layout)
    log = write_log(tmp_path, layout, messages, poses(messages, "/groundtruth", kind))
    for sides in ((trajectory, log), (log, trajectory), (log, log)):
        ate_m, matched, notes = errors(*sides)
        assert ate_m < 1e-8
        assert matched == COUNT
        assert "as logged" in notes[0]


def test_a_path_of_the_last_poses_is_joined(tmp_path: Path, trajectory: Path) -> None:
    messages = messages_for("mcap")
    logged = (("/path", s, messages.path(i, window=5)) for i, s in enumerate(STAMPS_NS))
    log = write_log(tmp_path, "mcap", messages, logged)
    assert errors(log, trajectory)[:2] == (pytest.approx(0, abs=1e-8), COUNT)


@pytest.mark.parametrize("layout", ["rosbag1", "sqlite"])
def test_frames_of_tf_are_chosen_and_connected(
    tmp_path: Path, trajectory: Path, layout: str
) -> None:
    messages = messages_for(layout)
    log = write_log(tmp_path, layout, messages, frames(messages))
    result = vo("eval", log, trajectory)
    assert result.exit_code == 1
    assert "choose the estimate with --topic estimate=/tf:map:odom" in result.output
    assert "/tf:odom:base" in result.output
    for child in ("base", "sensor"):
        ate_m, matched, _ = errors(log, trajectory, "--topic", f"estimate=/tf:map:{child}")
        assert matched == COUNT
        assert ate_m < 0.025  # map to odom is interpolated between every other stamp
    assert "no transforms connect frame 'map' to 'x'" in (
        vo("eval", log, trajectory, "--topic", "/tf:map:x").output
    )


def test_several_topics_are_listed_and_named(tmp_path: Path, trajectory: Path) -> None:
    messages = messages_for("rosbag1")

    def logged() -> Logged:
        for i, stamp_ns in enumerate(STAMPS_NS):
            yield "/groundtruth", stamp_ns, messages.pose("PoseStamped", stamp_ns, POSES[i])
            moved = POSES[i] @ se3_exp(np.array([0, 0, 0, 0.5, 0, 0]))
            yield "/odom", stamp_ns, messages.pose("Odometry", stamp_ns, moved)
            yield "/slam", stamp_ns, messages.pose("PoseStamped", stamp_ns, moved)

    log = write_log(tmp_path, "rosbag1", messages, logged())
    assert errors(trajectory, log)[0] < 1e-8  # named like ground truth
    result = vo("eval", log, trajectory)
    assert result.exit_code == 1
    assert "has poses in 3 places; choose the estimate with --topic estimate=" in result.output
    assert errors(log, trajectory, "--topic", "/odom")[0] == pytest.approx(0.5)
    both = ("--topic", "estimate=/slam", "--topic", "truth=/groundtruth")
    assert errors(log, log, *both)[0] == pytest.approx(0.5)
    for wrong, reason in (
        (("--topic", "/odm"), "has no poses '/odm'"),
        (("--topic", "left=/odom"), "say whose poses these are"),
        (("--topic", "truth=/odom"), "the truth is not a log"),
    ):
        result = vo("eval", log, trajectory, *wrong)
        assert result.exit_code == 1
        assert reason in result.output


def test_info_of_a_log_without_images(tmp_path: Path) -> None:
    messages = messages_for("sqlite")
    log = write_log(tmp_path, "sqlite", messages, poses(messages, "/gt", "Odometry"))
    result = vo("info", log)
    assert result.exit_code == 1
    lines = [line.split(maxsplit=1) for line in result.output.splitlines()]
    path_m = np.linalg.norm(np.diff(POSES[:, :3, 3], axis=0), axis=1).sum()
    assert ["truth", f"40 poses, 3.90 s at 10 Hz, {path_m:.1f} m of path"] in lines
    assert ["poses", "/gt (for vo eval --topic)"] in lines
    assert result.output.count("problem:") == 1
    assert not result.output.rstrip().endswith((":", "are"))
    assert "try:" not in result.output
