from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vo.base.errors import CalibrationError, OutputError
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.transforms import se3_exp
from vo.base.types import Camera, Rig
from vo.recordings.formats.calibration import FORMATS, document, read_calibration, write_calibration
from vo.recordings.formats.calibration.lenses import COUNTS, DISTORTION_NAMES

_ROOT = Path(__file__).parents[4]
_PAGE = _ROOT / "docs" / "calibration.md"
CAM = "resolution: [640, 480], intrinsics: [500, 501, 320, 240]"
ROTATION = [[0.9998477, -0.0174524, 0.0], [0.0174524, 0.9998477, 0.0], [0.0, 0.0, 1.0]]
ROWS = (
    "[[0.9998477, -0.0174524, 0, -0.1], [0.0174524, 0.9998477, 0, 0.02], [0, 0, 1, 0.03], "
    "[0, 0, 0, 1]]"
)


def _file(folder: Path, text: str, name: str = "calibration.yaml") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def _message(path: Path, size: tuple[int, int] | None = None) -> str:
    with pytest.raises(CalibrationError) as caught:
        read_calibration(path, size)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path.parent) in message
    return message


# Own format


def test_own_mono(tmp_path: Path) -> None:
    text = f"cam0: {{model: pinhole, {CAM}, distortion_model: radtan, distortion: [1e-3, 0, 0, 0]}}"
    rig = read_calibration(_file(tmp_path, text)).rig
    assert not rig.is_stereo
    cam0 = rig.cam0
    assert (cam0.width, cam0.height) == (640, 480)
    assert (cam0.fx, cam0.fy, cam0.cx, cam0.cy) == (500.0, 501.0, 320.0, 240.0)
    assert (cam0.distortion_model, cam0.distortion) == ("radtan", (0.001, 0.0, 0.0, 0.0))


def test_own_stereo_with_transform(tmp_path: Path) -> None:
    text = f"cam0: {{{CAM}}}\ncam1: {{{CAM}}}\ncam1_from_cam0: {ROWS}\n"
    rig = read_calibration(_file(tmp_path, text)).rig
    assert rig.cam1_from_cam0 is not None
    rotation = rig.cam1_from_cam0[:3, :3]
    np.testing.assert_allclose(rig.cam1_from_cam0[:3, 3], [-0.1, 0.02, 0.03])
    np.testing.assert_allclose(rotation, ROTATION, atol=1e-6)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("cam1", ["", f"cam1: {{{CAM}}}\n"])
def test_own_rectified_pair(tmp_path: Path, cam1: str) -> None:
    rig = read_calibration(_file(tmp_path, f"cam0: {{{CAM}}}\n{cam1}baseline_m: 0.54\n")).rig
    assert rig.cam1 == rig.cam0
    expected = np.eye(4)
    expected[0, 3] = -0.54
    assert rig.cam1_from_cam0 is not None
    np.testing.assert_array_equal(rig.cam1_from_cam0, expected)


RADTAN = Camera(752, 480, 458.654, 457.296, 367.215, 248.375, "radtan", (-0.28, 0.07, 2e-4, 1.8e-5))
RATIONAL = Camera(640, 400, 1 / 3e-3, 333.0, 321.7, 199.9, "radtan", tuple(np.arange(8) * 1e-7 / 3))
FISHEYE = Camera(848, 800, 285.1, 286.2, 424.5, 400.25, "equidistant", (-0.01, 0.04, -0.03, 1e-11))
SPHERES = Camera(512, 512, 158.28, 158.27, 254.9, 256.8, "double_sphere", (-0.17213, 1 / 1.7))
EXTENDED = Camera(752, 480, 460.7, 459.4, 365.8, 249.3, "extended_unified", (0.59, 1.127))
OMNI = Camera(752, 480, 833.0, 830.3, 373.8, 253.7, "omni", (0.8, -0.335, 0.132, 5e-4, 6e-4))
IDEAL = Camera(64, 48, 50.0, 51.0, 31.5, 23.5)


@pytest.mark.parametrize(
    "rig",
    [
        Rig(IDEAL),
        Rig(FISHEYE),
        Rig(SPHERES),
        Rig(replace(FISHEYE, readout_s=0.0213)),
        Rig(EXTENDED, OMNI, se3_exp(np.array([0.0, 0.01, 0.0, -0.1, 0.0, 0.0]))),
        Rig(RADTAN, RATIONAL, se3_exp(np.array([0.01, -0.02, 0.003, -0.11, 1e-3, -2e-4]))),
        Rig(IDEAL, IDEAL, se3_exp(np.array([0.0, 0.0, 0.0, -0.12, 0.0, 0.0]))),
    ],
    ids=[
        "ideal",
        "fisheye",
        "spheres",
        "rolling shutter",
        "wide pair",
        "distorted pair",
        "rectified pair",
    ],
)
def test_own_format_round_trip(tmp_path: Path, rig: Rig) -> None:
    write_calibration(tmp_path / "calibration.yaml", rig)
    again = read_calibration(tmp_path / "calibration.yaml").rig
    assert (again.cam0, again.cam1) == (rig.cam0, rig.cam1)
    if rig.cam1_from_cam0 is None:
        assert again.cam1_from_cam0 is None
    else:
        np.testing.assert_allclose(again.cam1_from_cam0, rig.cam1_from_cam0, rtol=0, atol=1e-15)


def test_a_global_shutter_is_not_written(tmp_path: Path) -> None:
    write_calibration(tmp_path / "calibration.yaml", Rig(IDEAL))
    assert "readout_s" not in (tmp_path / "calibration.yaml").read_text()


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("-0.01", r"readout_s is -0.01; it is the time from the first to the last row of an image"),
        ("20", r"readout_s is 20; it is the time .* in seconds, from 0 \(global shutter\) to 0.2"),
        ("fast", r"cam0.readout_s"),
    ],
)
def test_error_for_implausible_readout_times(tmp_path: Path, value: str, expected: str) -> None:
    with pytest.raises(CalibrationError, match=expected):
        read_calibration(_file(tmp_path, f"cam0: {{{CAM}, readout_s: {value}}}"))


def test_error_if_the_path_is_not_writable(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="missing.calibration.yaml cannot be written: No such"):
        write_calibration(tmp_path / "missing" / "calibration.yaml", Rig(IDEAL))


@pytest.mark.parametrize("name", DISTORTION_NAMES)
def test_every_name_of_a_distortion_model(tmp_path: Path, name: str) -> None:
    model = DISTORTION_NAMES[name]
    count = COUNTS[model][0]
    text = f"cam0: {{{CAM}, distortion_model: {name}, distortion: {[0.01] * count}}}"
    cam0 = read_calibration(_file(tmp_path, text)).rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == (model, (0.01,) * count)


@pytest.mark.parametrize("name", ["equi", "Radial_Tangential", "RADTAN", "Kannala-Brandt"])
def test_other_spellings_of_distortion_models(tmp_path: Path, name: str) -> None:
    text = f"cam0: {{{CAM}, distortion_model: {name}, distortion: {[0.01] * 4}}}"
    model = read_calibration(_file(tmp_path, text)).rig.cam0.distortion_model
    assert model == ("radtan" if name[0] == "R" else "equidistant")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("500,", ".nan,", "cam0: intrinsics [fx, fy, cx, cy], number 1 is nan; it must be"),
        ("501,", ".inf,", "number 2 is inf"),
        ("320,", "abc,", "number 3 is abc"),
        ("240]", "true]", "number 4 is True"),
        ("500,", "0,", "focal length is 0, 501; it must be above 0"),
        ("501,", "-501,", "focal length is 500, -501"),
        ("500, 501, 320, 240", "0.78, 1.04, 0.5, 0.5", "in pixels of the 640x480 image: multiply"),
        ("500, 501, 320, 240", "772.9, 1, 0, 0", "focal length is 772.9, 1;"),
        ("320,", "32000,", "principal point (32000, 240) is far outside the 640x480 image"),
        ("240]", "-500]", "principal point (320, -500) is far outside"),
        ("500, 501,", "500,", "has 3 numbers; 4 are needed"),
        ("[500, 501, 320, 240]", "500", "is 500; it must be a list of numbers"),
        ("resolution: [640, 480],", "", "resolution is missing; add resolution: [width, height]"),
        ("[640, 480]", "[0, 480]", "resolution is [0, 480]; width and height must be whole"),
        ("[640, 480]", "[640.5, 480]", "must be whole numbers above 0"),
        ("[640, 480]", "[640]", "has 1 numbers; 2 are needed"),
        ("cam0: {", "cam0: {model: fov, ", "camera model 'fov' is not supported"),
        ("cam0: {", "cam0: {model: ds, ", "intrinsics [xi, alpha, fx, fy, cx, cy] has 4 numbers"),
        ("cam0: {", "cam0: {resolutoin: 1, ", "key 'resolutoin'; did you mean 'resolution'?"),
        ("cam0: {", "baseline: 1\ncam0: {", "unknown key 'baseline'; did you mean 'baseline_m'?"),
        ("cam0: {", "cam0: {distortion: [0.1], ", "1 coefficients but distortion_model is missing"),
        ("cam0: {", "cam0: {distortion_model: fov, ", "distortion model 'fov' is not supported"),
        ("cam0: {", "cam0: [{", "is not YAML"),
    ],
)  # fmt: skip
def test_error_for_implausible_values(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = f"cam0: {{{CAM}}}\n"
    assert old in text
    assert expected in _message(_file(tmp_path, text.replace(old, new, 1)))


@pytest.mark.parametrize(
    ("model", "count", "counts"),
    [("radtan", 3, "4 or 5 or 8"), ("radtan", 6, "4 or 5 or 8"), ("plumb_bob", 0, "4 or 5 or 8"),
     ("equidistant", 5, "4"), ("none", 2, "0")],
)  # fmt: skip
def test_wrong_number_of_coefficients(tmp_path: Path, model: str, count: int, counts: str) -> None:
    text = f"cam0: {{{CAM}, distortion_model: {model}, distortion: {[0.1] * count}}}"
    message = _message(_file(tmp_path, text))
    assert f"distortion has {count} coefficients; {model} has {counts}" in message


@pytest.mark.parametrize(
    ("extra", "expected"),
    [
        ("baseline_m: 0", "the baseline is 0 m, so depth cannot be measured"),
        ("baseline_m: -0.5", "baseline_m is -0.5; it must be above 0"),
        ("baseline_m: wide", "baseline_m is wide; it must be a finite number"),
        (f"cam1: {{{CAM}}}", "give either cam1_from_cam0 (a 4x4 transform) or baseline_m"),
        (f"baseline_m: 1\ncam1_from_cam0: {ROWS}", "give either"),
        (f"cam1: 3\ncam1_from_cam0: {ROWS}", "cam1 is 3, not a section"),
        (f"cam1: {{{CAM}}}\ncam1_from_cam0: {ROWS.replace('0.0174524, 0.9', '0.0, 0.9', 1)}",
         "the rotation is not orthonormal"),
        (f"cam1: {{{CAM}}}\ncam1_from_cam0: {ROWS.replace('[0, 0, 1,', '[0, 0, -1,')}",
         "determinant -1)"),
        (f"cam1: {{{CAM}}}\ncam1_from_cam0: {ROWS.replace('[0, 0, 0, 1]', '[0, 0, 0, 2]')}",
         "the last row is [0.0, 0.0, 0.0, 2.0]"),
        (f"cam1: {{{CAM}}}\ncam1_from_cam0: {ROWS.replace('-0.1]', '.nan]')}",
         "cam1_from_cam0, row 1, number 4 is nan"),
        (f"cam1: {{{CAM}}}\ncam1_from_cam0: [[1, 0], [0, 1]]", "2 numbers; 16 are needed"),
    ],
)  # fmt: skip
def test_error_for_implausible_pairs(tmp_path: Path, extra: str, expected: str) -> None:
    text = f"cam0: {{{CAM}}}\n{extra}\n"
    if "cam1_from_cam0" in extra and "cam1:" not in extra:
        text += f"cam1: {{{CAM}}}\n"
    assert expected in _message(_file(tmp_path, text))


# Files that are none


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "",
            "not a calibration file of a supported format (KITTI raw, KITTI, COLMAP, ZED, Basalt, ",
        ),
        ("fx: 500", "docs/calibration.md"),
        ("- 1\n- 2", "not a calibration file of a supported format"),
        ("a: b: c", "is not YAML: mapping values are not allowed here"),
    ],
)
def test_error_for_unknown_formats(tmp_path: Path, text: str, expected: str) -> None:
    assert expected in _message(_file(tmp_path, text))


def test_missing_and_binary_files(tmp_path: Path) -> None:
    assert "does not exist" in _message(tmp_path / "none.yaml")
    assert "cannot be read" in _message(tmp_path)
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe\x81")
    assert "is not text" in _message(tmp_path / "b.yaml")


# Kalibr

CHAIN = f"""
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.37, 0.2, 0.002, 0.001, -0.07]
  distortion_model: radtan5
  {CAM.replace(", intr", chr(10) + "  intr")}
  T_cam_imu: [[0, 1, 0, 0.5], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
cam1:
  camera_model: pinhole
  distortion_coeffs: [0.1, 0.2, 0.3, 0.4]
  distortion_model: equidistant
  {CAM.replace(", intr", chr(10) + "  intr")}
  T_cn_cnm1: {ROWS}
"""


def test_kalibr(tmp_path: Path) -> None:
    calibration = read_calibration(_file(tmp_path, CHAIN, "camchain.yaml"))
    rig = calibration.rig
    assert rig.cam0.distortion == (-0.37, 0.2, 0.002, 0.001, -0.07)
    assert rig.cam1 is not None
    assert (rig.cam1.distortion_model, rig.cam1.distortion) == ("equidistant", (0.1, 0.2, 0.3, 0.4))
    assert rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(rig.cam1_from_cam0[:3, 3], [-0.1, 0.02, 0.03])
    assert calibration.body_from_cam0 is not None
    np.testing.assert_allclose(calibration.body_from_cam0[:3, 3], [0, -0.5, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("T_cn_cnm1", "T_other", "cam1.T_cn_cnm1 is missing"),
        ("pinhole", "fov", "cam0: camera model 'fov' is not supported"),
        ("-0.1]", "0]", "baseline"),
        ("resolution: [640, 480]", "comment: none", "cam0: resolution is missing"),
    ],
)
def test_error_for_implausible_kalibr_files(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    text = CHAIN.replace(old, new, 1)
    if expected == "baseline":
        text = text.replace("0.02]", "0]").replace("0.03]", "0]")
    assert expected in _message(_file(tmp_path, text, "camchain.yaml"))


# EuRoC


def _sensor(x: float) -> str:
    # As in the EuRoC data sets: rounded, and the pose of cam1 is in its T_BS.
    data = f"[0, -1, 0, {x}, 1, 0, 0, 0.2, 0, 0, 1, 0.3, 0, 0, 0, 1]"
    return (
        f"sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: {data}\n"
        "rate_hz: 20\nresolution: [752, 480]\ncamera_model: pinhole\n"
        "intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv\n"
        "distortion_model: radial-tangential\n"
        "distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]\n"
    )


def test_euroc_pair(tmp_path: Path) -> None:
    left = _file(tmp_path, _sensor(0.1), "cam0/sensor.yaml")
    _file(tmp_path, _sensor(0.3), "cam1/sensor.yaml")
    calibration = read_calibration(left)
    assert calibration.rig.cam0.distortion == (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)
    assert calibration.body_from_cam0 is not None
    np.testing.assert_allclose(calibration.body_from_cam0[:3, 3], [0.1, 0.2, 0.3])
    # cam1 is 0.2 m along the body's x, which is -y of the cameras.
    assert calibration.rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(calibration.rig.cam1_from_cam0[:3, 3], [0, 0.2, 0], atol=1e-12)


def test_euroc_with_a_readout_time(tmp_path: Path) -> None:
    text = f"{_sensor(0.1)}\nreadout_s: 0.02\n"
    assert read_calibration(_file(tmp_path, text, "cam0/sensor.yaml")).rig.cam0.readout_s == 0.02


def test_euroc_alone_is_mono(tmp_path: Path) -> None:
    assert not read_calibration(_file(tmp_path, _sensor(0.1), "cam0/sensor.yaml")).rig.is_stereo
    _file(tmp_path, _sensor(0.3), "cam1/sensor.yaml")
    assert not read_calibration(tmp_path / "cam1/sensor.yaml").rig.is_stereo


def test_euroc_partner_of_a_folder_that_is_a_link(tmp_path: Path) -> None:
    _file(tmp_path, _sensor(0.1), "shared/cam0/sensor.yaml")
    _file(tmp_path, _sensor(0.2), "shared/cam1/sensor.yaml")
    _file(tmp_path, _sensor(0.3), "mine/cam1/sensor.yaml")
    (tmp_path / "mine" / "cam0").symlink_to(tmp_path / "shared" / "cam0")
    rig = read_calibration(tmp_path / "mine" / "cam0" / "sensor.yaml").rig
    assert rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(np.abs(rig.cam1_from_cam0[:3, 3]).max(), 0.2)


def test_error_for_a_euroc_pair_without_baseline(tmp_path: Path) -> None:
    left = _file(tmp_path, _sensor(0.1), "cam0/sensor.yaml")
    _file(tmp_path, _sensor(0.1), "cam1/sensor.yaml")
    with pytest.raises(CalibrationError, match="cam1/sensor.yaml: T_BS: the baseline is 0 m"):
        read_calibration(left)


def test_error_for_euroc_without_extrinsics(tmp_path: Path) -> None:
    path = _file(tmp_path, _sensor(0.1).replace("T_BS", "T_XY"), "sensor.yaml")
    assert "T_BS is missing" in _message(path)


# KITTI

K = "707.0912 0 601.8873 {} 0 707.0912 183.1104 0 0 0 1 0"
KITTI = f"P0: {K.format(0)}\nP1: {K.format(-379.8145)}\n"


def test_kitti(tmp_path: Path) -> None:
    rig = read_calibration(_file(tmp_path, KITTI, "calib.txt"), (1226, 370)).rig
    assert (rig.cam0.width, rig.cam0.height, rig.cam0.fx) == (1226, 370, 707.0912)
    assert rig.cam1_from_cam0 is not None
    assert rig.cam1_from_cam0[0, 3] == pytest.approx(-0.537150653267924, abs=1e-12)


def test_kitti_is_not_parsed_as_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(document, "sections_of", None)
    assert read_calibration(_file(tmp_path, KITTI, "calib.txt"), (1226, 370)).kind == "KITTI"


def test_kitti_with_one_camera(tmp_path: Path) -> None:
    path = _file(tmp_path, KITTI.splitlines()[0], "calib.txt")
    assert not read_calibration(path, (1226, 370)).rig.is_stereo


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("-379.8145", "0", "P1: the baseline is 0 m"),
        ("P0: 707.0912", "P0: nan", "P0, number 1 is nan"),
        ("P0: 707.0912", "P0: -707.0912", "P0: focal length is -707.091"),
        ("P0: 707.0912", "P0:", "P0 has 11 numbers; 12 are needed"),
        ("P0: 707.0912 0 601.8873", "P0: 707.0912 0 6018.873", "far outside the 1226x370 image"),
    ],
)
def test_error_for_implausible_kitti_files(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    assert old in KITTI
    assert expected in _message(_file(tmp_path, KITTI.replace(old, new), "calib.txt"), (1226, 370))


def test_kitti_without_the_left_camera(tmp_path: Path) -> None:
    path = _file(tmp_path, KITTI.splitlines()[1], "calib.txt")
    assert "P0 is missing" in _message(path, (1226, 370))


# The documented examples


def test_documented_examples_can_be_read(tmp_path: Path) -> None:
    """Every block is a complete file of our own format."""
    pairs = []
    for block in _PAGE.read_text("utf-8").split("```yaml\n")[1:]:
        calibration = read_calibration(_file(tmp_path, block.split("```")[0], "own.txt"))
        assert calibration.kind == "vo"
        pairs.append(rectified_rig(calibration.rig).is_metric)
    assert pairs[:3] == [False, True, True]


def test_example_files_can_be_read() -> None:
    """The page links to one of each format, under a heading with its name."""
    links = r"### ([^\n]+)\n\nExample: \[[^\]]+\]\(\.\./([^)]+)\)"
    kinds = []
    for title, file in re.findall(links, _PAGE.read_text("utf-8")):
        size = (1280, 720) if title == "ZED" else (1226, 370)
        assert read_calibration(_ROOT / file, size).kind == title
        kinds.append(title)
    assert {"vo", *kinds} == set(FORMATS)
    assert len(kinds) == len(list((_ROOT / "examples/calibration").iterdir()))


def test_warning_for_a_baseline_in_millimetres(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = f"cam0: {{{CAM}}}\ncam1: {{{CAM}}}\nbaseline_m: 540\n"
    read_calibration(_file(tmp_path, text))
    assert [r.message for r in caplog.records if "540 m; if the unit is millimetres" in r.message]
    caplog.clear()
    read_calibration(_file(tmp_path, text.replace("540", "0.54")))
    assert not caplog.records
