"""Positions as other programs and devices write them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores import ros2_humble as ros

from vo.base.errors import SourceError
from vo.recordings.formats.positions import read_nmea
from vo.runs.scaling.positions import read_positions

FIX = "sensor_msgs/msg/NavSatFix"
ODOMETRY = "nav_msgs/msg/Odometry"
START_NS = 1_700_000_000_000_000_000


def sentence(body: str) -> str:
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}"


def gga(time: str, latitude: str = "4807.038,N", longitude: str = "01131.000,E") -> str:
    return sentence(f"GPGGA,{time},{latitude},{longitude},1,08,0.9,545.4,M,46.9,M,,")


def rmc(time: str, date: str) -> str:
    return sentence(f"GPRMC,{time},A,4807.038,N,01131.000,E,022.4,084.4,{date},003.1,W")


def unix_ns(text: str) -> int:
    return int(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp() * 1e9)


def nmea(path: Path, *lines: str) -> Path:
    path.write_text("\r\n".join(lines) + "\r\n", encoding="ascii")
    return path


def test_nmea_of_a_receiver(tmp_path: Path) -> None:
    found = read_nmea(
        nmea(
            tmp_path / "a.nmea",
            gga("123518.00"),
            rmc("123519.00", "230394"),
            gga("123519.50", "4807.038,S", "01131.000,W"),
            sentence("GPGGA,123520,,,,,0,00,99.9,,,,,,"),  # no fix
            gga("123521.00").replace("4807", "4808"),  # damaged
            sentence("GPGSV,1,1,00"),
        )
    )
    day = "1994-03-23 12:35:"
    assert found.stamps_ns.tolist() == [unix_ns(day + "18"), unix_ns(day + "19.500")]
    degrees = 48 + 7.038 / 60, 11 + 31 / 60
    np.testing.assert_allclose(found.values[0], (*degrees, 592.3), rtol=1e-12)
    np.testing.assert_allclose(found.values[1], (-degrees[0], -degrees[1], 592.3), rtol=1e-12)
    np.testing.assert_allclose(found.sigma_m, 1.8)
    assert found.is_geodetic and not found.is_time_of_day


def test_nmea_over_midnight(tmp_path: Path) -> None:
    dated = [rmc("235959.00", "311299"), gga("235959.00"), gga("000000.00")]
    dated += [rmc("000000.00", "010100"), gga("000001.00")]
    found = read_nmea(nmea(tmp_path / "a.nmea", *dated))
    assert np.diff(found.stamps_ns).tolist() == [10**9, 10**9]
    assert found.stamps_ns[-1] == unix_ns("2000-01-01 00:00:01")
    undated = [gga("235959.00"), gga("000000.00"), gga("000001.00")]
    found = read_nmea(nmea(tmp_path / "b.nmea", *undated))
    assert found.is_time_of_day and np.diff(found.stamps_ns).tolist() == [10**9, 10**9]


def test_csv_by_the_names_of_its_columns(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("Time, Y, X\n1.5, 2, 1\n2.5, 4, 3\n")
    found = read_positions(str(tmp_path / "a.csv"))
    assert found.stamps_ns.tolist() == [1_500_000_000, 2_500_000_000]
    assert found.xyz.tolist() == [[1, 2, 0], [3, 4, 0]]
    assert (found.source, found.origin) == ("positions", None)
    (tmp_path / "b.csv").write_text("stamp_ns,lat,lon,alt\n5,48,11,500\n9,48.00001,11,501\n")
    found = read_positions(str(tmp_path / "b.csv"))
    assert found.source == "gps" and found.stamps_ns.tolist() == [5, 9]
    np.testing.assert_allclose(found.xyz, [[0, 0, 0], [0, 1.112, 1]], atol=1e-3)


def test_a_trajectory(tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text("1 1 2 3 0 0 0 1\n2 2 3 4 0 0 0 1\n")
    found = read_positions(str(tmp_path / "a.tum"))
    assert found.source == "trajectory" and found.xyz.tolist() == [[1, 2, 3], [2, 3, 4]]


def test_oxts_of_kitti(tmp_path: Path) -> None:
    data = tmp_path / "drive" / "oxts" / "data"
    data.mkdir(parents=True)
    for number in range(3):
        (data / f"{number:010d}.txt").write_text(f"49.0 {8.0 + 1e-5 * number} 112.0 0 0 0\n")
    stamps = "".join(f"2011-09-26 13:02:2{n}.500000000\n" for n in range(3))
    (data.parent / "timestamps.txt").write_text(stamps)
    for given, recording in ((str(data.parent), None), ("auto", str(tmp_path / "drive"))):
        found = read_positions(given, recording)
        np.testing.assert_allclose(np.diff(found.xyz[:, 0]), 0.7323, atol=1e-3)
        assert found.stamps_ns[0] == unix_ns("2011-09-26 13:02:20.500")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log with a GPS receiver and wheel odometry, without cameras."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        for topic, kind in (("/fix", FIX), ("/odom", ODOMETRY)):
            definition, _ = store.generate_msgdef(kind)
            schema = writer.register_schema(kind, "ros2msg", definition.encode())
            channel = writer.register_channel(topic, "cdr", schema)
            for number in range(4):
                stamp_ns = START_NS + number * 10**9
                message = (fix if kind == FIX else odometry)(stamp_ns, number)
                data = bytes(store.serialize_cdr(message, kind))
                writer.add_message(channel, stamp_ns, data, stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return tmp_path / "a.mcap"


def header(stamp_ns: int) -> ros.std_msgs__msg__Header:
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(seconds, nanoseconds), "gps")


def fix(stamp_ns: int, number: int) -> ros.sensor_msgs__msg__NavSatFix:
    status = ros.sensor_msgs__msg__NavSatStatus(-1 if number == 2 else 0, 1)
    covariance = np.diag([4.0, 4.0, 4.0]).ravel()
    return ros.sensor_msgs__msg__NavSatFix(
        header(stamp_ns), status, 48.0 + 1e-5 * number, 11.0, 500.0, covariance, 2
    )


def odometry(stamp_ns: int, number: int) -> ros.nav_msgs__msg__Odometry:
    zero = ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0)
    pose = ros.geometry_msgs__msg__Pose(
        ros.geometry_msgs__msg__Point(0.5 * number, 0.0, 0.0),
        ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0),
    )
    return ros.nav_msgs__msg__Odometry(
        header(stamp_ns),
        "base",
        ros.geometry_msgs__msg__PoseWithCovariance(pose, np.zeros(36)),
        ros.geometry_msgs__msg__TwistWithCovariance(
            ros.geometry_msgs__msg__Twist(zero, zero), np.zeros(36)
        ),
    )


def test_gps_and_odometry_of_a_log(log: Path) -> None:
    gps = read_positions(str(log))
    assert gps.source == "gps" and len(gps.stamps_ns) == 3  # one message has no fix
    np.testing.assert_allclose(gps.sigma_m, 2.0)
    np.testing.assert_allclose(gps.xyz[-1], (0.0, 3.336, 0.0), atol=1e-3)
    wheels = read_positions("auto:/odom", str(log))
    assert wheels.source == "odometry" and wheels.xyz[:, 0].tolist() == [0.0, 0.5, 1.0, 1.5]
    with pytest.raises(SourceError, match="no positions on /gps; it has /fix, /odom"):
        read_positions(f"{log}:/gps")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.nmea", "$GPGGA,120000,,,,,0,,,,,,,,\n", "no position"),
        ("a.csv", "time,x,y\n1,2,three\n", "a.csv:2"),
        ("b.csv", "time,x,y\n", "no line of data"),
        ("c.csv", "1,2,3\n", "columns are not a trajectory"),
        ("c.kml", "<kml/>\n", "gpsbabel -i kml -f .*c.kml"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "without stamps"),
    ],
)
def test_bad_files(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SourceError, match=message):
        read_positions(str(tmp_path / name))


def test_what_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="does not exist"):
        read_positions(str(tmp_path / "none"))
    with pytest.raises(SourceError, match="has no positions of another sensor"):
        read_positions(str(tmp_path))
    with pytest.raises(SourceError, match="needs a recording"):
        read_positions("auto")


SRT = {
    "dji": "[latitude: 47.0000{0}] [longitude: 8.5] [rel_alt: 1.000 abs_alt: 401.5]",
    "typo": "[latitude : 47.0000{0}] [longtitude : 8.5] [altitude: 401.5]",
    "mini": "F/2.8, SS 206.14, ISO 150, GPS (8.5, 47.0000{0}, 16), D 0.0m, H 401.5m",
}


@pytest.mark.parametrize("kind", SRT)
def test_subtitles_of_a_drone(tmp_path: Path, kind: str) -> None:
    cues = [
        f"{i + 1}\n00:01:{i:02d},033 --> 00:01:{i:02d},066\n{SRT[kind].format(i)}\n\n"
        for i in range(4)
    ]
    lost = "5\n00:01:05,000 --> 00:01:06,000\n[latitude: 0.0] [longitude: 0.0]\n"
    (tmp_path / "walk.SRT").write_text("\r\n".join([*"".join(cues).split("\n"), lost]))
    found = read_positions(str(tmp_path / "walk.SRT"))
    assert found.stamps_ns.tolist() == [(60 + i) * 10**9 + 33_000_000 for i in range(4)]
    assert found.origin is not None
    np.testing.assert_allclose(found.origin, [47.0, 8.5, 401.5])
    np.testing.assert_allclose(found.xyz[:, 1], [1.11 * i for i in range(4)], atol=0.01)


AIRDATA = (
    "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet),"
    "altitude_above_seaLevel(feet),speed(mph),isPhoto,isVideo\n"
)


def flight(videos: Sequence[int]) -> str:
    return AIRDATA + "".join(
        f"{100 * i},2020-09-13 12:26:40,{47 + 1e-5 * i:.7f},8.5,{i},1000,0,0,{is_video}\n"
        for i, is_video in enumerate(videos)
    )


def test_a_flight_log_of_one_video(tmp_path: Path) -> None:
    (tmp_path / "flight.csv").write_text(flight([0, 0, 1, 1, 1, 0]))
    found = read_positions(str(tmp_path / "flight.csv"))
    assert found.stamps_ns.tolist() == [0, 100_000_000, 200_000_000]
    assert found.origin is not None
    np.testing.assert_allclose(found.origin, [47.00002, 8.5, 304.8])
    np.testing.assert_allclose(found.xyz[:, 1], [0.0, 1.1118, 2.2235], atol=1e-3)


def test_a_flight_log_of_several_videos(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "flight.csv").write_text(flight([1, 0, 1]))
    found = read_positions(str(tmp_path / "flight.csv"))
    assert found.stamps_ns.tolist() == [0, 100_000_000, 200_000_000]
    assert "has 2 videos" in caplog.text


def test_a_flight_record_of_dji(tmp_path: Path) -> None:
    head = "sep=,\nCUSTOM.date [local],OSD.flyTime [s],OSD.latitude,OSD.longitude,OSD.altitude [m]"
    rows = "".join(f"\n9/13/2020,{0.1 * i:.1f},47.00{i},8.5,400.5" for i in range(3))
    (tmp_path / "record.csv").write_text(head + rows)
    found = read_positions(str(tmp_path / "record.csv"))
    assert found.stamps_ns.tolist() == [0, 100_000_000, 200_000_000]
    assert found.origin is not None
    assert found.origin[2] == 400.5


def test_gpx(tmp_path: Path) -> None:
    points = "".join(
        f'<trkpt lon="8.5" lat="47.0000{i}"><ele>400</ele>'
        f"<time>2020-09-13T12:26:4{i}.5Z</time></trkpt>"
        for i in range(3)
    )
    (tmp_path / "walk.gpx").write_text(f"<?xml version='1.0'?><gpx><trk>{points}</trk></gpx>")
    found = read_positions(str(tmp_path / "walk.gpx"))
    assert found.stamps_ns.tolist() == [unix_ns(f"2020-09-13T12:26:4{i}.5") for i in range(3)]
    (tmp_path / "walk.gpx").write_text("<gpx><wpt lat='47' lon='8'></wpt></gpx>")
    with pytest.raises(SourceError, match="GPX without positions that have times"):
        read_positions(str(tmp_path / "walk.gpx"))
