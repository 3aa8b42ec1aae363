"""Damaged files: every parser raises an error of one line, and never hangs."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest
from calibration_files import BASALT, COLMAP_HEADER, KITTI_RAW, ORB_FISHEYE, basalt_file
from foreign_files import CAMODOCAL_MEI, MAPLAB, OKVIS, OPENSFM, STELLA, ZED, depthai, nerf
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vo.base.errors import CalibrationError, VoError
from vo.recordings.formats.calibration import FORMATS, read_calibration
from vo.recordings.formats.trajectory import read_trajectory

KALIBR = """cam0:
  camera_model: omni
  distortion_coeffs: [-0.3, 0.1, 0.001, 0.002]
  distortion_model: radtan
  intrinsics: [0.8, 317.5, 316.1, 324.8, 246.5]
  resolution: [640, 480]
  T_cam_imu: [[0, 1, 0, 0.5], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
cam1:
  camera_model: pinhole
  distortion_coeffs: [0.1, 0.2, 0.3, 0.4]
  distortion_model: equidistant
  intrinsics: [317.5, 316.1, 324.8, 246.5]
  resolution: [640, 480]
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
"""
EUROC = """sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, 0.3, 0, 0, 0, 1]
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
"""
ROS = """image_width: 640
image_height: 480
camera_name: left
camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.01, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [500, 0, 320, -55, 0, 500, 240, 0, 0, 0, 1, 0]}
"""
OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<M1 type_id="opencv-matrix">
  <rows>3</rows><cols>3</cols><dt>d</dt>
  <data>500. 0. 320. 0. 501. 240. 0. 0. 1.</data></M1>
<D1 type_id="opencv-matrix"><rows>1</rows><cols>4</cols><dt>d</dt><data>0.1 0.2 0 0</data></D1>
<M2 type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>500. 0. 320. 0. 501. 240. 0. 0. 1.</data></M2>
<D2 type_id="opencv-matrix"><rows>1</rows><cols>4</cols><dt>d</dt><data>0.1 0.2 0 0</data></D2>
<R type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>1 0 0 0 1 0 0 0 1</data></R>
<T type_id="opencv-matrix"><rows>3</rows><cols>1</cols><dt>d</dt><data>-0.1 0. 0.</data></T>
<image_size>640 480</image_size>
</opencv_storage>
"""
OWN = """cam0:
  resolution: [640, 480]
  intrinsics: [500, 501, 320, 240]
  distortion_model: double_sphere
  distortion: [-0.2, 0.6]
baseline_m: 0.12
"""
FILES = {
    "KITTI raw": KITTI_RAW,
    "KITTI": "P0: 707.1 0 601.9 0 0 707.1 183.1 0 0 0 1 0\n"
    "P1: 707.1 0 601.9 -379.8 0 707.1 183.1 0 0 0 1 0\n",
    "COLMAP": COLMAP_HEADER + "1 OPENCV 640 480 600 601 320 240 0.1 0.2 0.3 0.4\n",
    "ZED": ZED,
    "Camera matrix": "600.5, 0.0, 320.1\n0.0, 601.5, 240.2\n0.0, 0.0, 1.0\n",
    "DSO": "RadTan 600 601 320 240 0.1 0.2 0.003 0.004\n640 480\ncrop\n640 480\n",
    "Basalt": basalt_file("ds", BASALT["ds"][0]),
    "DepthAI": depthai(),
    "NeRF": nerf(),
    "OpenSfM": OPENSFM,
    "SVO or maplab": MAPLAB,
    "OKVIS": OKVIS,
    "camodocal": CAMODOCAL_MEI,
    "stella_vslam": STELLA,
    "ORB-SLAM3": ORB_FISHEYE,
    "ROS camera_info": ROS,
    "OpenCV": OPENCV_XML,
    "Kalibr": KALIBR,
    "EuRoC": EUROC,
    "vo": OWN,
}
NASTY = (
    "nan", "-inf", "1e308", "1e-308", "-1", "0", "1" * 400, "[", "]",
    "{", "}", ":", "- ", "&a", "*a",
    "!!int ''", "!!timestamp x", "!!binary ?", "2024-13-45", "0x", "1:99", "null", "~", "true",
    "<", "</M1>", "<_/>", "\n", "\t", "\x00", "'", '"', "%YAML:1.0\n", "---\n", "? ", "cam0", "é",
)  # fmt: skip
SECONDS = 5.0


def _size(kind: str) -> tuple[int, int]:
    """Size of the images; files of ZED cameras have sections for some sizes only."""
    return (1280, 720) if kind == "ZED" else (640, 480)


def _mutated(text: str, random: Random) -> bytes:
    """A text with one to four damages: bytes, lines, tokens lost, doubled, swapped or replaced."""
    for _ in range(random.randint(1, 4)):
        at, other = (random.randrange(len(text) + 1) for _ in range(2))
        first, last = min(at, other), max(at, other)
        text = [
            text[:at] + chr(random.randrange(128)) + text[at + 1 :],
            text[:at] + random.choice(NASTY) + text[at:],
            text[:at] + random.choice(NASTY) + text[at + random.randint(1, 12) :],
            text[:first] + text[min(last, first + 40) :],
            text[:last] + text[first:last] + text[last:],
            text[:at],
        ][random.randrange(6)]
    data = text.encode("utf-8", "surrogatepass")
    if random.random() < 0.1:
        data = data[: len(data) // 2] + bytes([random.randrange(256)]) + data[len(data) // 2 :]
    return data


def _survives(read: Callable[[Path], object], path: Path, kind: type[VoError]) -> bool:
    """Whether a file can still be read; checks the error and the duration if not."""
    begun = time.process_time()
    try:
        read(path)
    except kind as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 1500
        return False
    finally:
        assert time.process_time() - begun < SECONDS, path.read_bytes()[:400]
    return True


def test_all_formats_have_a_damage_test() -> None:
    assert set(FILES) == set(FORMATS)


@pytest.mark.parametrize("kind", FILES)
def test_whole_files_are_read(tmp_path: Path, kind: str) -> None:
    (tmp_path / "c").write_text(FILES[kind], encoding="utf-8")
    assert read_calibration(tmp_path / "c", _size(kind)).kind == kind


@pytest.mark.parametrize("kind", FILES)
def test_damaged_calibrations(tmp_path: Path, kind: str) -> None:
    random, path, alive = Random(7), tmp_path / "c", 0
    for _ in range(40):
        path.write_bytes(_mutated(FILES[kind], random))
        alive += _survives(lambda p: read_calibration(p, _size(kind)), path, CalibrationError)
    assert alive < 40


@pytest.mark.parametrize("kind", FILES)
def test_calibrations_cut_off(tmp_path: Path, kind: str) -> None:
    text, path = FILES[kind], tmp_path / "c"
    for length in range(0, len(text), max(1, len(text) // 12)):
        path.write_text(text[:length], encoding="utf-8")
        _survives(lambda p: read_calibration(p, _size(kind)), path, CalibrationError)


@settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    kind=st.sampled_from(sorted(FILES)),
    values=st.lists(
        st.tuples(
            st.integers(0, 60),
            st.one_of(
                st.floats().map(str), st.integers().map(str), st.text(max_size=8),
                st.sampled_from(NASTY),
            ),
        ),
        min_size=1, max_size=4,
    ),
)  # fmt: skip
def test_any_value_at_any_key(tmp_path: Path, kind: str, values: list[tuple[int, str]]) -> None:
    words = FILES[kind].split(" ")
    for at, value in values:
        words[at % len(words)] = value
    (tmp_path / "c").write_text(" ".join(words), encoding="utf-8", errors="surrogatepass")
    _survives(lambda p: read_calibration(p, _size(kind)), tmp_path / "c", CalibrationError)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        "cam0: " + "{a: " * 50_000,
        "- " * 20_000,
        '{"value0": ' * 50_000,
        "<a>" * 50_000,
        '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><x>&b;</x>',
        "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\ncam0: {resolution: *c, intrinsics: *c}\n",
        "cam0: &c {resolution: *c, intrinsics: *c}",
        "&a [*a]",
        "x: " + "1" * 300_000,
        "1 PINHOLE " + "9" * 5000 + " 5 600 600 1 1",
        "x" * 600_000,
    ],
    ids=lambda text: text[:12],
)
def test_malicious_texts(tmp_path: Path, text: str) -> None:
    (tmp_path / "c").write_text(text, encoding="utf-8")
    assert not _survives(read_calibration, tmp_path / "c", CalibrationError)


# Trajectories

TRAJECTORIES = {
    "tum": "# stamp tx ty tz qx qy qz qw\n"
    "1.5 0.1 0.2 0.3 0 0 0 1\n2.5 0.2 0.2 0.3 0 0 0.7071 0.7071\n3.5 0.3 0.2 0.3 0 0 0 1\n",
    "kitti": "1 0 0 0.1 0 1 0 0 0 0 1 0\n1 0 0 0.2 0 1 0 0 0 0 1 0\n",
    "euroc": "#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z\n"
    "1403636580838555648,4.6,-1.7,0.7,0.5,-0.1,-0.8,-0.1\n"
    "1403636580843555328,4.6,-1.7,0.7,0.5,-0.1,-0.8,-0.1\n",
}


@pytest.mark.parametrize("kind", TRAJECTORIES)
def test_damaged_trajectories(tmp_path: Path, kind: str) -> None:
    random, path, alive = Random(3), tmp_path / "t.txt", 0
    for _ in range(150):
        path.write_bytes(_mutated(TRAJECTORIES[kind], random))
        alive += _survives(read_trajectory, path, VoError)
    assert 0 < alive < 150


@settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    kind=st.sampled_from(sorted(TRAJECTORIES)),
    at=st.integers(0, 40),
    value=st.one_of(st.floats().map(str), st.integers().map(str), st.text(max_size=8)),
)
def test_any_value_in_any_field_of_a_trajectory(
    tmp_path: Path, kind: str, at: int, value: str
) -> None:
    separator = "," if kind == "euroc" else " "
    words = TRAJECTORIES[kind].split(separator)
    words[at % len(words)] = value
    (tmp_path / "t").write_text(separator.join(words), "utf-8", errors="surrogatepass")
    _survives(read_trajectory, tmp_path / "t", VoError)
