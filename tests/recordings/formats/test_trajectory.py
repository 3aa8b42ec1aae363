from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vo.base.errors import OutputError, SourceError
from vo.base.geometry.transforms import quat_xyzw_from_rotation, se3_exp
from vo.base.types import Trajectory
from vo.recordings.formats.stamp_units import stamp_ns_from_seconds
from vo.recordings.formats.trajectory import (
    detect_format,
    read_euroc,
    read_kitti,
    read_kitti_times,
    read_trajectory,
    read_tum,
    tum_line,
    write_tum,
)

TUM = "1.5 1 2 3 0 0 0 1\n"
KITTI = "1 0 0 4 0 1 0 5 0 0 1 6\n"


def written(folder: Path, text: str, name: str = "path.txt") -> Path:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


@settings(deadline=None)
@given(stamp_ns=st.integers(-(2**62), 2**62))
def test_stamps_are_exact_to_the_nanosecond(stamp_ns: int) -> None:
    text = tum_line(stamp_ns, np.eye(4)).split()[0]
    assert len(text.split(".")[1]) == 9
    assert stamp_ns_from_seconds(text) == stamp_ns


def test_seconds_may_be_written_with_an_exponent() -> None:
    assert stamp_ns_from_seconds("1.044989e-01") == 104_498_900
    assert stamp_ns_from_seconds("1305031098.6659") == 1_305_031_098_665_900_000


def test_tum_round_trip(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    poses = np.array([se3_exp(rng.normal(scale=2.0, size=6)) for _ in range(50)])
    stamps_ns = np.cumsum(rng.integers(1, 10**9, size=50)) + 1_600_000_000_000_000_001
    write_tum(tmp_path / "t.tum", Trajectory(stamps_ns, poses))
    back = read_trajectory(tmp_path / "t.tum")
    np.testing.assert_array_equal(back.stamps_ns, stamps_ns)
    np.testing.assert_allclose(back.world_from_cam, poses, atol=1e-8)


def test_tum_line_has_no_negative_zero() -> None:
    pose = np.eye(4)
    pose[:3, 3] = -1e-15
    assert tum_line(0, pose) == (
        "0.000000000 0.000000000 0.000000000 0.000000000 "
        "0.000000000 0.000000000 0.000000000 1.000000000"
    )


def test_tum_skips_comments_and_blank_lines(tmp_path: Path) -> None:
    path = written(tmp_path, "\ufeff# stamp tx ty tz\n\n" + TUM)
    trajectory = read_trajectory(path)
    assert trajectory.stamps_ns.tolist() == [1_500_000_000]
    np.testing.assert_array_equal(trajectory.positions, [[1, 2, 3]])


def test_quaternions_are_normalised(tmp_path: Path) -> None:
    path = written(tmp_path, "0 0 0 0 0 0 0.02 0.02\n")
    expected = se3_exp(np.array([0, 0, np.pi / 2, 0, 0, 0]))
    np.testing.assert_allclose(read_tum(path).world_from_cam[0], expected, atol=1e-12)


def test_kitti_stamps_come_from_times_txt(tmp_path: Path) -> None:
    path = written(tmp_path, KITTI * 2)
    assert read_trajectory(path).stamps_ns.tolist() == [0, 10**9]
    times = written(tmp_path, "0.0\n1.044989e-01\n", "times.txt")
    trajectory = read_trajectory(path)
    assert trajectory.stamps_ns.tolist() == [0, 104_498_900]
    assert read_kitti_times(times).tolist() == [0, 104_498_900]
    np.testing.assert_array_equal(trajectory.positions, [[4, 5, 6]] * 2)


def test_kitti_stamps_of_another_length_are_not_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = written(tmp_path, KITTI * 2)
    written(tmp_path, "0.5\n", "times.txt")
    with caplog.at_level(logging.WARNING):
        assert read_trajectory(path).stamps_ns.tolist() == [0, 10**9]
    assert "1 stamps for 2 poses" in caplog.text


@pytest.mark.parametrize(
    "header",
    [
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x []\n",
        "timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z\n",
        "",
    ],
)
@pytest.mark.parametrize("rest", ["", ",0.1,0.2,0.3,0,0,0,0,0,0"])
def test_euroc_with_any_header(tmp_path: Path, header: str, rest: str) -> None:
    row = f"1403636580838555648,4.5,-1.7,0.8,0,1,0,0{rest}\n"
    path = written(tmp_path, header + row, "data.csv")
    trajectory = read_trajectory(path)
    assert trajectory.stamps_ns.tolist() == [1403636580838555648]
    np.testing.assert_array_equal(trajectory.positions, [[4.5, -1.7, 0.8]])
    np.testing.assert_array_equal(trajectory.world_from_cam[0, :3, :3], np.diag([1, -1, -1]))


def test_format_is_detected_from_the_content(tmp_path: Path) -> None:
    assert detect_format(written(tmp_path, TUM)) == "tum"
    assert detect_format(written(tmp_path, KITTI)) == "kitti"
    assert detect_format(written(tmp_path, "0,1,2,3,1,0,0,0\n")) == "euroc"


def test_repeated_stamps_keep_the_first(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = written(tmp_path, TUM + "1.5 9 9 9 0 0 0 1\n2.5 4 5 6 0 0 0 1\n")
    with caplog.at_level(logging.WARNING):
        trajectory = read_trajectory(path)
    np.testing.assert_array_equal(trajectory.positions, [[1, 2, 3], [4, 5, 6]])
    assert "1 pose with a repeated stamp left out" in caplog.text


@pytest.mark.parametrize(
    "gap", ["2.5 nan nan nan nan nan nan nan", "2.5 1 inf 3 0 0 0 1", "2.5 0 0 0 0 0 0 0"]
)
@pytest.mark.parametrize("kind", ["tum", "euroc"])
def test_lines_without_a_pose_are_left_out(
    tmp_path: Path, gap: str, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    lines = ["1.5 1 2 3 0 0 0 1", gap, "3.5 4 5 6 0 0 0 1", gap.replace("2.5", "4.5")]
    if kind == "euroc":
        lines = [line.replace(".5 ", "500000000 ").replace(" ", ",") for line in lines]
        lines = [line.replace("0,0,0,1", "1,0,0,0") for line in lines]
    trajectory = read_trajectory(written(tmp_path, "\n".join(lines) + "\n"))
    assert trajectory.stamps_ns.tolist() == [1_500_000_000, 3_500_000_000]
    np.testing.assert_array_equal(trajectory.positions, [[1, 2, 3], [4, 5, 6]])
    (record,) = caplog.records
    assert "path.txt:2: 2 of 4 lines are not poses" in record.getMessage()


@pytest.mark.parametrize("end", ["2.5 1 2 3 0 0 0", "2.5 1 2", "\0\0\0\0"])
def test_incomplete_last_line_is_left_out(
    tmp_path: Path, end: str, caplog: pytest.LogCaptureFixture
) -> None:
    trajectory = read_tum(written(tmp_path, TUM + end))
    assert trajectory.stamps_ns.tolist() == [1_500_000_000]
    (record,) = caplog.records
    assert "path.txt:2: the last line is cut off" in record.getMessage()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no line of data"),
        ("# only a comment\n", "no line of data"),
        (TUM + "2.5 1 2 3 0 0 0\n", r"path\.txt:2: 7 columns, 8 expected"),
        ("2.5 1 nan 3 0 0 0 1\n", r"path\.txt:1: 1 of 1 lines are not poses"),
        (KITTI + "1 0 0 nan 0 1 0 5 0 0 1 6\n", r"path\.txt:2: column 4 is nan"),
        (TUM + "2.5 1 1e13 3 0 0 0 1\n", r"path\.txt:2: column 3 is 1e13"),
        (TUM + "2.5 1 x 3 0 0 0 1\n", r"path\.txt:2: could not convert.*'x'"),
        (TUM + "1.25 1 2 3 0 0 0 1\n", r"path\.txt:2: stamp goes back by 0\.25 s"),
        ("soon 1 2 3 0 0 0 1\n", r"path\.txt:1: stamp 'soon' is not a number of seconds"),
        ("nan 1 2 3 0 0 0 1\n", r"path\.txt:1: stamp nan is out of range for seconds"),
        ("1e99999999 1 2 3 0 0 0 1\n", "out of range"),
        ("1 2 3\n", r"path\.txt:1: 3 columns are not a trajectory"),
        (KITTI + "1 0 0 4 0 2 0 5 0 0 1 6\n", r"path\.txt:2: the 3x3 part is not a rotation"),
        (KITTI + "1 0 0 4 0 1 0 5 0 0 -1 6\n", r"path\.txt:2: the 3x3 part is not a rotation"),
        ("1.5,1,2,3,1,0,0,0\n", r"stamp '1\.5' is not a whole number of nanoseconds"),
        ("1" * 40 + ",1,2,3,1,0,0,0\n", "too large for a time in nanoseconds"),
    ],
)
def test_error_names_the_damaged_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(SourceError, match=message) as caught:
        read_trajectory(written(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_missing_file_folder_and_binary(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="does not exist"):
        read_trajectory(tmp_path / "none.tum")
    with pytest.raises(SourceError, match="cannot be read"):
        read_trajectory(tmp_path)
    (tmp_path / "image.png").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(SourceError, match="is not text"):
        read_trajectory(tmp_path / "image.png")


def test_kitti_with_another_number_of_stamps(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="1 pose but 2 stamps"):
        read_kitti(written(tmp_path, KITTI), np.array([0, 1]))


def test_euroc_needs_eight_columns(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="4 columns, at least 8 expected"):
        read_euroc(written(tmp_path, "1403636580838555648,1,2,3\n"))


def test_error_if_the_path_is_not_writable(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        write_tum(tmp_path, Trajectory(np.array([0]), np.eye(4)[None]))


@pytest.mark.parametrize("step_us", [5_000, 37_000, 100_000])
def test_times_in_whole_microseconds_are_no_nanoseconds(tmp_path: Path, step_us: int) -> None:
    path = tmp_path / "a.tum"
    stamps_us = [1_600_000_000_123_456 + i * step_us for i in range(9)]
    path.write_text("".join(f"{t} {t % 7} 0 0 0 0 0 1\n" for t in stamps_us), encoding="utf-8")
    assert read_tum(path).stamps_ns.tolist() == [1000 * t for t in stamps_us]


def test_times_in_whole_milliseconds_are_read_as_such(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pose = "1 0 0 0 0 1 0 0 0 0 1 0\n"
    (tmp_path / "poses.txt").write_text(pose * 4, encoding="utf-8")
    (tmp_path / "times.txt").write_text("0\n104\n207\n311\n", encoding="utf-8")
    trajectory = read_trajectory(tmp_path / "poses.txt")
    assert trajectory.stamps_ns.tolist() == [0, 104_000_000, 207_000_000, 311_000_000]
    assert "the stamps are read as milliseconds" in caplog.text


@pytest.mark.parametrize(
    ("heading", "order", "mark"),
    [
        ("timestamp,tx,ty,tz,qx,qy,qz,qw", "t123xyzw", ","),
        ("#timestamp [ns], qw, qx, qy, qz, px, py, pz", "twxyz123", ","),
        ("# time x y z qw qx qy qz", "t123wxyz", " "),
        (
            "%time,field.pose.pose.position.x,field.pose.pose.position.y,field.pose.pose.position.z,"
            "field.pose.pose.orientation.x,field.pose.pose.orientation.y,"
            "field.pose.pose.orientation.z,field.pose.pose.orientation.w",
            "t123xyzw",
            ",",
        ),
        ("# timestamp tx ty tz qx qy qz qw", "t123xyzw", " "),
    ],
)
def test_columns_by_the_names_in_the_heading(
    tmp_path: Path, heading: str, order: str, mark: str
) -> None:
    rows = []
    for i in range(3):
        field = {
            "t": 1_600_000_000_000_000_000 + i * 50_000_000,
            **dict(zip("xyz", (0.6, 0, 0), strict=True)),
        }
        field |= {"w": 0.8, "1": 1 + i, "2": 2, "3": 3}
        rows.append(mark.join(str(field[each]) for each in order))
    path = tmp_path / "a.csv"
    path.write_text("\n".join([heading, *rows]) + "\n")
    found = read_trajectory(path)
    assert found.stamps_ns.tolist() == [
        1_600_000_000_000_000_000 + i * 50_000_000 for i in range(3)
    ]
    np.testing.assert_allclose(found.positions, [[1 + i, 2, 3] for i in range(3)])
    np.testing.assert_allclose(found.world_from_cam[0, 1:3, 2], [-0.96, 0.28], atol=1e-12)


def test_tum_with_commas_and_whole_matrices(tmp_path: Path) -> None:
    """As pandas writes them, without a heading."""
    true = se3_exp(np.array([0.3, -0.2, 0.5, 1.0, 2.0, 3.0]))
    quat = quat_xyzw_from_rotation(true[:3, :3])
    row = ",".join(f"{value:.12f}" for value in (1600000000.0, *true[:3, 3], *quat))
    (tmp_path / "a.csv").write_text(f"{row}\n")
    matrix = " ".join(f"{value:.12f}" for value in true.ravel())
    (tmp_path / "a.txt").write_text(f"{matrix}\n")
    for name in ("a.csv", "a.txt"):
        found = read_trajectory(tmp_path / name)
        np.testing.assert_allclose(found.world_from_cam[0], true, atol=1e-9)
