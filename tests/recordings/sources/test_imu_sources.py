"""Inertial measurements of each format: exact, in time order, read on demand."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import bag_logs
import layouts
import mcap_logs
import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

import vo
from vo.base.errors import SourceError
from vo.base.geometry.transforms import inverse, se3_exp
from vo.base.types import Floats, Ints
from vo.recordings.formats.foxglove import FOXGLOVE
from vo.recordings.formats.messages import ImuMessage, Message
from vo.recordings.formats.ros2 import ROS2
from vo.recordings.sources.imu import Imu, ImuSamples
from vo.recordings.sources.logs.imu import LogImu, imu_topics
from vo.recordings.sources.mcap.file import McapFile
from vo.recordings.sources.registry import open_source

SAMPLES = 40
STEP_NS = 20_000_003
_noise = np.random.default_rng(5)
STAMPS_NS: Ints = layouts.STAMPS_NS[0] - 50_000_000 + STEP_NS * np.arange(SAMPLES, dtype=np.int64)
GYRO: Floats = _noise.normal(0.0, 0.3, (SAMPLES, 3))
ACCEL: Floats = _noise.normal(0.0, 0.5, (SAMPLES, 3)) + [0.0, 0.0, 9.81]


def imu_messages(topic: str = "/imu/data", frame: str = "body") -> Iterator[tuple[str, Message]]:
    for stamp, gyro, accel in zip(STAMPS_NS.tolist(), GYRO, ACCEL, strict=True):
        yield topic, ImuMessage(stamp, frame, gyro, accel)


def all_messages(frame: str = "body") -> list[tuple[str, Message]]:
    both = [*layouts.log_messages(), *imu_messages(frame=frame)]
    return sorted(both, key=lambda each: each[1].stamp_ns)


def the_imu(path: Path) -> Imu:
    (imu,) = open_source(path).imus
    return imu


def check_exact(samples: ImuSamples, rows: slice | list[int] = slice(None)) -> None:
    assert np.array_equal(samples.stamps_ns, STAMPS_NS[rows])
    assert np.array_equal(samples.gyro, GYRO[rows])
    assert np.array_equal(samples.accel, ACCEL[rows])


@pytest.mark.parametrize("container", ["ros2", "foxglove", "rosbag1", "rosbag2"])
def test_samples_of_logs_are_exact(tmp_path: Path, container: str) -> None:
    path = tmp_path / {"rosbag1": "a.bag", "rosbag2": "bag"}.get(container, "a.mcap")
    if container == "rosbag1":
        bag_logs.write_bag1(path, all_messages())
    elif container == "rosbag2":
        bag_logs.write_bag2(path, all_messages())
    else:
        mcap_logs.write_log(path, all_messages(), mcap_logs.DIALECTS[container])
    imu = the_imu(path)
    assert imu.name == "/imu/data" and len(imu.stamps_ns) == SAMPLES
    check_exact(imu.read())
    assert imu.cam0_from_imu == pytest.approx(inverse(layouts.BODY_FROM_CAM0), abs=1e-12)
    check_exact(imu.read(int(STAMPS_NS[7]), int(STAMPS_NS[11])), slice(7, 12))
    assert len(imu.read(int(STAMPS_NS[7]) + 1, int(STAMPS_NS[8]) - 1)) == 0


def test_ros1_messages_in_mcap(tmp_path: Path) -> None:
    store, name = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/Imu"
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros1")
        definition, _ = store.generate_msgdef(name)
        schema = writer.register_schema("sensor_msgs/Imu", "ros1msg", definition.encode())
        channel = writer.register_channel("/imu", "ros1", schema)
        for _, message in imu_messages():
            data = bytes(get_typestore(Stores.ROS2_HUMBLE).cdr_to_ros1(ROS2.encode(message), name))
            writer.add_message(channel, message.stamp_ns, data, message.stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    log = McapFile(tmp_path / "a.mcap")
    (topic,) = imu_topics(log.topics)
    check_exact(LogImu(log, topic, lambda _: None).read())


def test_samples_of_synthetic_recordings_are_exact(synthetic_stereo: Path) -> None:
    imu = the_imu(synthetic_stereo)
    table = np.loadtxt(
        synthetic_stereo / "mav0" / "imu0" / "data.csv", str, delimiter=",", skiprows=1
    )
    samples = imu.read()
    assert samples.stamps_ns.tolist() == [int(stamp) for stamp in table[:, 0]]
    assert np.array_equal(np.hstack([samples.gyro, samples.accel]), table[:, 1:].astype(float))
    assert np.median(np.linalg.norm(samples.accel, axis=1)) == pytest.approx(9.81, abs=0.6)
    assert imu.noise is not None and imu.noise.gyro_noise == pytest.approx(1.7e-4, rel=0.5)
    source = open_source(synthetic_stereo)
    assert source.ground_truth is not None and imu.cam0_from_imu is not None
    assert abs(np.linalg.det(imu.cam0_from_imu[:3, :3]) - 1.0) < 1e-9


def euroc_table(folder: Path, lines: list[str], sensor: str | None) -> None:
    heading = "#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z"
    layouts.write_text(folder / "mav0/imu0/data.csv", "\n".join([heading, *lines]) + "\n")
    if sensor is not None:
        layouts.write_text(folder / "mav0/imu0/sensor.yaml", sensor)


def euroc_lines() -> list[str]:
    rows = zip(STAMPS_NS.tolist(), GYRO, ACCEL, strict=True)
    return [f"{stamp},{','.join(map(repr, [*g.tolist(), *a.tolist()]))}" for stamp, g, a in rows]


def test_euroc_contains_the_extrinsics(euroc: Path) -> None:
    body_from_imu = se3_exp(np.array([0.1, -0.2, 0.3, 0.01, 0.02, 0.03]))
    euroc_table(euroc, euroc_lines(), layouts.sensor_yaml(body_from_imu))
    imu = the_imu(euroc)
    check_exact(imu.read())
    expected = inverse(layouts.BODY_FROM_CAM0) @ body_from_imu
    assert imu.cam0_from_imu == pytest.approx(expected, abs=1e-9)
    (euroc / "mav0/imu0/sensor.yaml").unlink()
    assert the_imu(euroc).cam0_from_imu is None


def test_kalibr_contains_the_extrinsics(euroc: Path, tmp_path: Path) -> None:
    euroc_table(euroc, euroc_lines(), None)
    cam_from_imu = se3_exp(np.array([0.3, 0.1, -0.2, 0.05, 0.0, 0.1]))
    camera = {
        "camera_model": "pinhole",
        "intrinsics": layouts.INTRINSICS,
        "resolution": [layouts.WIDTH, layouts.HEIGHT],
        "distortion_model": "radtan",
        "distortion_coeffs": [0.0] * 4,
        "T_cam_imu": cam_from_imu.tolist(),
    }
    layouts.write_text(tmp_path / "camchain.yaml", json.dumps({"cam0": camera}))
    mcap_logs.write_log(tmp_path / "a.mcap", all_messages(frame="somewhere"))
    assert the_imu(tmp_path / "a.mcap").cam0_from_imu is None
    for path in (euroc, tmp_path / "a.mcap"):
        source = open_source(path, calibration=tmp_path / "camchain.yaml", mode="mono")
        assert source.imus[0].cam0_from_imu == pytest.approx(cam_from_imu, abs=1e-9)


def test_kitti_raw_samples_are_in_the_frame_of_the_unit(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    layouts.write_kitti_raw(drive)
    for i, (gyro, accel) in enumerate(zip(GYRO, ACCEL, strict=False)):
        if i < layouts.COUNT:
            fields = [49.0, 8.4, 110.0, 0.02, 0.01, 1.3, *[5.0] * 5, *accel, *[7.0] * 3, *gyro]
            text = " ".join(map(repr, map(float, [*fields, *[0.5] * 3, 0.1, 0.1, *[4] * 5])))
            layouts.write_text(drive / "oxts" / "data" / f"{i:010d}.txt", text)
    imu = the_imu(drive)
    samples = imu.read()
    assert samples.stamps_ns.tolist() == layouts.STAMPS_NS
    assert np.array_equal(samples.gyro, GYRO[: layouts.COUNT])
    assert np.array_equal(samples.accel, ACCEL[: layouts.COUNT])
    assert imu.cam0_from_imu == pytest.approx(np.eye(4), abs=1e-9)


def spoiled_log(path: Path) -> Path:
    """Every eighth message is truncated, and one contains NaN."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        count = 0
        for topic, message in all_messages():
            if topic not in channels:
                schema = ROS2.schema(type(message))
                number = writer.register_schema(
                    schema.name, ROS2.schema_encoding, schema.definition
                )
                channels[topic] = writer.register_channel(topic, ROS2.message_encoding, number)
            data = ROS2.encode(message)
            if isinstance(message, ImuMessage):
                if count == 3:
                    bad = np.array([np.nan, 0.0, 0.0])
                    data = ROS2.encode(ImuMessage(message.stamp_ns, "body", bad, message.accel))
                data = data[:50] if count % 8 == 0 else data
                count += 1
            writer.add_message(channels[topic], message.stamp_ns, data, message.stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def test_one_warning_for_damaged_samples_when_they_are_read(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = open_source(spoiled_log(tmp_path / "a.mcap"))
    with caplog.at_level(logging.WARNING, "vo"):
        assert len(list(source.frames())) == layouts.COUNT
        assert caplog.messages == []
        samples = source.imus[0].read()
    assert caplog.messages == [
        "/imu/data: 6 of 40 samples are damaged or not finite and are skipped"
    ]
    kept = [i for i in range(SAMPLES) if i % 8 and i != 3]
    assert np.array_equal(samples.stamps_ns, STAMPS_NS[kept]) and samples.unreadable == 6
    assert np.array_equal(samples.accel, ACCEL[kept])


def test_one_warning_for_damaged_lines_of_a_table(
    euroc: Path, caplog: pytest.LogCaptureFixture
) -> None:
    lines = euroc_lines()
    lines[4] = "not a line"
    lines[9] = lines[9].rpartition(",")[0]
    lines[11] = lines[10]
    lines[20], lines[21] = lines[21], lines[20]
    euroc_table(euroc, lines, None)
    source = open_source(euroc)
    with caplog.at_level(logging.WARNING, "vo"):
        samples = source.imus[0].read()
    assert [message.split(": ", 1)[1] for message in caplog.messages] == [
        "2 of 40 lines cannot be read and are skipped",
        "1 of 40 lines repeat a stamp and are skipped",
    ]
    check_exact(samples, [i for i in range(SAMPLES) if i not in (4, 9, 11)])


def test_one_of_several_sensors_is_chosen(tmp_path: Path) -> None:
    more = [(f"/{i % 2}/imu", m) for i, (_, m) in enumerate(imu_messages()) if i < 21]
    mcap_logs.write_log(tmp_path / "a.mcap", [*all_messages(), *more], FOXGLOVE)
    names = [imu.name for imu in open_source(tmp_path / "a.mcap").imus]
    assert names == ["/imu/data", "/0/imu", "/1/imu"]
    chosen = open_source(tmp_path / "a.mcap", topics=["imu=/1/imu"])
    assert [imu.name for imu in chosen.imus] == ["/1/imu", "/imu/data", "/0/imu"]
    with pytest.raises(SourceError, match="/truth is not the topic of an inertial sensor"):
        open_source(tmp_path / "a.mcap", topics=["imu=/truth"])


def test_gyroscope_and_accelerometer_topics_are_joined(tmp_path: Path) -> None:
    zero = np.zeros(3)
    parts: list[tuple[str, Message]] = []
    for stamp, gyro in zip(STAMPS_NS.tolist(), GYRO, strict=True):
        parts.append(("/camera/gyro/sample", ImuMessage(stamp, "body", gyro, zero)))
    for i in range(0, SAMPLES, 3):
        accel = np.array([0.1 * i, 2.0, 9.81 - 0.01 * i])
        stamp = int(STAMPS_NS[i]) + 1_000_000
        parts.append(("/camera/accel/sample", ImuMessage(stamp, "body", zero, accel)))
    both = sorted([*layouts.log_messages(), *parts], key=lambda each: each[1].stamp_ns)
    mcap_logs.write_log(tmp_path / "a.mcap", both)
    imu = the_imu(tmp_path / "a.mcap")
    assert imu.name == "/camera/gyro/sample with /camera/accel/sample"
    samples = imu.read()
    assert np.array_equal(samples.stamps_ns, STAMPS_NS[1:])  # the first comes before
    assert np.array_equal(samples.gyro, GYRO[1:])
    share = (samples.stamps_ns - STAMPS_NS[0] - 1_000_000) / STEP_NS
    expected = np.stack([0.1 * share, 2.0 + 0 * share, 9.81 - 0.01 * share], axis=1)
    assert samples.accel == pytest.approx(expected, abs=1e-9)
    part = imu.read(int(STAMPS_NS[8]), int(STAMPS_NS[10]))
    assert part.accel == pytest.approx(expected[7:10], abs=1e-9)
    assert np.array_equal(part.gyro, GYRO[8:11])
    assert imu.cam0_from_imu == pytest.approx(inverse(layouts.BODY_FROM_CAM0), abs=1e-12)
    assert len(imu.read_some(10)) == 10


def test_excerpts_of_many_samples(tmp_path: Path) -> None:
    mcap_logs.write_log(tmp_path / "a.mcap", all_messages())
    imu = the_imu(tmp_path / "a.mcap")
    some = imu.read_some(20)
    assert len(some) == 20 and some.stamps_ns[[0, -1]].tolist() == STAMPS_NS[[0, -1]].tolist()
    check_exact(imu.read_some(SAMPLES))


IN_UNITS = {"rad/s": 1.0, "deg/s": 180 / np.pi, "m/s^2": 1.0, "g": 1 / 9.80665}
HEADINGS = {
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]": "ns gx gy gz ax ay az",
    "timestamp,ax,ay,az,gx,gy,gz": "ns ax ay az gx gy gz",
    "#time [s], acc_z [g], acc_y [g], acc_x [g], gyro_z [deg/s], gyro_y [deg/s], gyro_x [deg/s]": (
        "s az:g ay:g ax:g gz:deg/s gy:deg/s gx:deg/s"
    ),
    "AccelX (m/s^2);AccelY (m/s^2);AccelZ (m/s^2);"
    "GyroX (dps);GyroY (dps);GyroZ (dps);Temp;t (us)": ("ax ay az gx:deg/s gy:deg/s gz:deg/s 1 us"),
    "%time,field.orientation.x,field.angular_velocity.x,field.angular_velocity.y,"
    "field.angular_velocity.z,field.angular_velocity_covariance0,field.linear_acceleration.x,"
    "field.linear_acceleration.y,field.linear_acceleration.z": "ns 0 gx gy gz 7 ax ay az",
    "timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z": "s ax ay az gx gy gz",
    "# timestamp(ns) omega_x omega_y omega_z alpha_x_unknown a b c": "ns gx gy gz ax ay az",
}


@pytest.mark.parametrize("heading", HEADINGS)
def test_columns_by_the_names_in_the_heading(
    tmp_path: Path, heading: str, caplog: pytest.LogCaptureFixture
) -> None:
    layouts.write_euroc(tmp_path)
    mark = next((each for each in ",;" if each in heading), " ")

    def field(word: str, row: int) -> str:
        name, _, unit = word.partition(":")
        if name in ("ns", "us", "s"):
            stamp = int(STAMPS_NS[row])
            return {"ns": f"{stamp}", "us": f"{stamp // 1000}"}.get(name, layouts.seconds(stamp))
        if len(name) == 1:
            return name
        values = {"g": GYRO, "a": ACCEL}[name[0]][row]
        return repr(float(values["xyz".index(name[1])] * IN_UNITS.get(unit, 1.0)))

    words = HEADINGS[heading].split()
    rows = [mark.join(field(word, row) for word in words) for row in range(SAMPLES)]
    layouts.write_text(tmp_path / "mav0/imu0/data.csv", "\n".join([heading, *rows]) + "\n")
    samples = the_imu(tmp_path).read()
    np.testing.assert_allclose(samples.stamps_ns, STAMPS_NS, atol=1000)
    np.testing.assert_allclose(samples.gyro, GYRO, rtol=1e-9)
    np.testing.assert_allclose(samples.accel, ACCEL, rtol=1e-9)
    assert ("does not name" in caplog.text) == ("unknown" in heading)


@pytest.mark.parametrize("is_cut", [False, True])
@pytest.mark.parametrize("to", ["mcap", "mcap-ros2"])
def test_noise_that_is_written_with_a_log_is_read(
    to: Literal["mcap", "mcap-ros2"], is_cut: bool, synthetic_stereo: Path, tmp_path: Path
) -> None:
    """Also from a file whose index is lost."""
    known = vo.open(synthetic_stereo).imus[0].noise
    assert known is not None
    path = vo.convert(synthetic_stereo, tmp_path / "log.mcap", to=to)
    if is_cut:
        path.write_bytes(path.read_bytes()[:-20])
    assert vo.open(path).imus[0].noise == known
