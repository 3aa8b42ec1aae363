"""Inspection of inertial sensors, and of topics that are not read."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores import ros2_humble as ros
from typer.testing import CliRunner

from vo.cli.app import app
from vo.recordings.formats.messages import ImuMessage
from vo.recordings.formats.ros2 import ROS2
from vo.tools.inspection.inertial import imu_findings
from vo.tools.inspection.inspection import inspect
from vo.tools.inspection.opening import open_leniently
from vo.tools.inspection.reports import ImuReport, Report

IMU, TEXT = "sensor_msgs/msg/Imu", "std_msgs/msg/String"
START_NS = 1_700_000_000_000_000_000


def report_of(path: Path) -> Report:
    return inspect(open_leniently(path), 2)


def the_imu(path: Path) -> ImuReport:
    (imu,) = report_of(path).imu
    return imu


def finding_texts(path: Path) -> str:
    return "\n".join(finding.what for finding in report_of(path).findings)


@pytest.fixture
def walk(synthetic_stereo: Path, tmp_path: Path) -> Path:
    """A copy that tests may modify."""
    return Path(shutil.copytree(synthetic_stereo, tmp_path / "walk"))


def scaled(walk: Path, gyro: float, accel: float) -> None:
    """Convert the measurements to other units."""
    table = walk / "mav0" / "imu0" / "data.csv"
    heading, *lines = table.read_text().splitlines()
    rows = []
    for stamp, *values in (line.split(",") for line in lines):
        factors = [gyro] * 3 + [accel] * 3
        rows.append(
            ",".join([stamp, *(repr(float(v) * f) for v, f in zip(values, factors, strict=True))])
        )
    table.write_text("\n".join([heading, *rows]) + "\n")


def test_a_sound_sensor_is_described(synthetic_stereo: Path) -> None:
    imu = the_imu(synthetic_stereo)
    table = synthetic_stereo / "mav0" / "imu0" / "data.csv"
    lines = table.read_text().splitlines()[1:]
    accel = np.array([[float(v) for v in line.split(",")[4:]] for line in lines])
    assert imu.name == str(table) and imu.count == imu.looked_at == len(lines)
    assert (imu.rate_hz, imu.gaps, imu.covered) == (pytest.approx(200.0), 0, 1.0)
    assert imu.accel_m_s2 == pytest.approx(np.linalg.norm(accel, axis=1).mean())
    assert imu.cam0_from_imu is not None and np.shape(imu.cam0_from_imu) == (4, 4)
    assert imu.noise is not None and imu.noise["gyro_noise"] == pytest.approx(1.7e-4, rel=0.5)
    assert list(imu_findings(imu)) == []


@pytest.mark.parametrize(
    ("gyro", "accel", "words"),
    [
        (1.0, 1 / 9.80665, "probably in g"),
        (1.0, 0.1 / 9.80665, "with gravity it should be about 9.81"),
        (1.0, 3.28084, "instead of about 9.81"),
        (180 / np.pi, 1.0, "probably in degrees"),
    ],
)
def test_wrong_units_are_reported(walk: Path, gyro: float, accel: float, words: str) -> None:
    scaled(walk, gyro, accel)
    assert words in finding_texts(walk)


def test_gaps_damage_and_another_clock_are_reported(walk: Path) -> None:
    table = walk / "mav0" / "imu0" / "data.csv"
    lines = table.read_text().splitlines()
    stamp, *values = lines[300].split(",")
    lines[300] = ",".join([stamp, "nan", *values[1:]])
    table.write_text("\n".join([*lines[:100], *lines[120:]]) + "\n")
    text = finding_texts(walk)
    assert "gaps: 1, the longest 0.105 s" in text
    assert f"1 of {len(lines) - 21} lines cannot be read" in text
    moved = [f"{int(line.split(',')[0]) + 10**12},{line.split(',', 1)[1]}" for line in lines[1:]]
    table.write_text("\n".join(moved) + "\n")
    assert "covers 0 % of the images" in finding_texts(walk)


def test_a_sensor_that_cannot_be_read_is_a_warning(walk: Path) -> None:
    (walk / "mav0" / "imu0" / "data.csv").write_text("#timestamp\n")
    report = report_of(walk)
    assert report.imu == ()
    assert "has no data" in "\n".join(finding.what for finding in report.findings)


def samples() -> Iterator[tuple[int, bytes]]:
    for i in range(30):
        stamp = START_NS + i * 5_000_000
        accel = np.array([0.0, 0.0, 9.81])
        yield stamp, ROS2.encode(ImuMessage(stamp, "imu", np.zeros(3), accel))


def text(store: Stores) -> tuple[str, bytes, bytes]:
    """Definition of a text message, and a message in CDR and in ROS 1 serialisation."""
    types = get_typestore(store)
    definition, _ = types.generate_msgdef(TEXT)
    of_ros2 = get_typestore(Stores.ROS2_HUMBLE)
    cdr = bytes(of_ros2.serialize_cdr(ros.std_msgs__msg__String(data="hello"), TEXT))
    return definition, cdr, bytes(of_ros2.cdr_to_ros1(cdr, TEXT))


def mcap(path: Path) -> Path:
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        definition, cdr, _ = text(Stores.ROS2_HUMBLE)
        imu = writer.register_schema(IMU, "ros2msg", ROS2.schema(ImuMessage).definition)
        string = writer.register_schema(TEXT, "ros2msg", definition.encode())
        channels = [
            writer.register_channel(topic, "cdr", schema)
            for topic, schema in (("/imu", imu), ("/chatter", string), ("/silent", imu))
        ]
        for stamp, data in samples():
            writer.add_message(channels[0], stamp, data, stamp)
            if stamp < START_NS + 20_000_000:
                writer.add_message(channels[1], stamp, cdr, stamp)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def rosbag1(path: Path) -> Path:
    store, of_ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    with Rosbag1Writer(path) as writer:
        imu = writer.add_connection("/imu", IMU, typestore=store)
        chatter = writer.add_connection("/chatter", TEXT, typestore=store)
        writer.add_connection("/silent", IMU, typestore=store)
        for stamp, data in samples():
            writer.write(imu, stamp, of_ros2.cdr_to_ros1(data, IMU))
            if stamp < START_NS + 20_000_000:
                writer.write(chatter, stamp, text(Stores.ROS1_NOETIC)[2])
    return path


def rosbag2(path: Path, plugin: StoragePlugin) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Rosbag2Writer(path, version=9, storage_plugin=plugin) as writer:
        imu = writer.add_connection("/imu", IMU, typestore=store)
        chatter = writer.add_connection("/chatter", TEXT, typestore=store)
        writer.add_connection("/silent", IMU, typestore=store)
        for stamp, data in samples():
            writer.write(imu, stamp, data)
            if stamp < START_NS + 20_000_000:
                writer.write(chatter, stamp, text(Stores.ROS2_HUMBLE)[1])
    return path


@pytest.mark.parametrize("container", ["mcap", "rosbag1", "sqlite", "rosbag2-mcap"])
def test_all_topics_of_a_log_are_listed(tmp_path: Path, container: str) -> None:
    path = {
        "mcap": lambda: mcap(tmp_path / "a.mcap"),
        "rosbag1": lambda: rosbag1(tmp_path / "a.bag"),
        "sqlite": lambda: rosbag2(tmp_path / "a", StoragePlugin.SQLITE3),
        "rosbag2-mcap": lambda: rosbag2(tmp_path / "a", StoragePlugin.MCAP),
    }[container]()
    result = CliRunner().invoke(app, ["info", str(path), "--json"])
    assert result.exit_code == 1  # there is no camera
    report = json.loads(result.stdout)
    found = {
        topic["name"]: (topic["schema"].split("/")[-1], topic["count"], topic["is_read"])
        for topic in report["topics"]
    }
    assert found == {
        "/imu": ("Imu", 30, True),
        "/chatter": ("String", 4, False),
        "/silent": ("Imu", 0, False),
    }
    (imu,) = report["imu"]
    assert (imu["name"], imu["count"], imu["covered"]) == ("/imu", 30, None)
    assert imu["accel_m_s2"] == pytest.approx(9.81) and imu["cam0_from_imu"] is None
    assert imu["noise"] is None
    lines = CliRunner().invoke(app, ["info", str(path)]).stdout.splitlines()
    assert any("noise unknown (taken as that of a consumer sensor)" in line for line in lines)
    assert [line.split()[-3:] for line in lines if "/chatter" in line] == [["read", "by", "vo)"]]
    assert any("/silent" in line and line.endswith("(no messages)") for line in lines)
