"""Recordings of more than two cameras, laid out as others write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from layouts import HEIGHT, STAMPS_NS, WIDTH, image, write_image, write_text

from data_synth.cameras import load_rig
from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, se3_exp
from vo.base.types import Frame
from vo.recordings.formats.calibration import read_calibration, write_calibration
from vo.recordings.sources.registry import open_source

YAWS = (0.0, 0.6, 1.2, 2.0)
BODY_FROM_CAMS = np.stack(
    [se3_exp(np.array([0.0, yaw, 0.01, 0.1 * i, 0.02, 0.3])) for i, yaw in enumerate(YAWS)]
)
LENS = {"resolution": [WIDTH, HEIGHT], "intrinsics": [50.0, 51.0, 31.5, 23.5]}


def camera(index: int, number: int) -> np.ndarray:
    pixels = image(index)
    pixels[0, 1] = number
    return pixels


def kalibr(count: int, by_imu: bool = False) -> dict[str, Any]:
    """A camera chain as Kalibr writes it."""
    chain = {}
    for n in range(count):
        section = {"camera_model": "pinhole", "distortion_model": "none", **LENS}
        section |= {"distortion_coeffs": [], "rostopic": f"/cam{n}/image_raw"}
        if by_imu:
            section["T_imu_cam"] = BODY_FROM_CAMS[n].tolist()
        elif n:
            section["T_cn_cnm1"] = (inverse(BODY_FROM_CAMS[n]) @ BODY_FROM_CAMS[n - 1]).tolist()
        chain[f"cam{n}"] = section
    return chain


def write_mav(root: Path, count: int, late_ms: float = 0.0, missing: int | None = None) -> Path:
    """EuRoC's layout with any number of cameras."""
    for n in range(count):
        folder = root / "mav0" / f"cam{n}"
        if n == missing:
            continue
        stamps = [stamp + round(n * late_ms * 1e6) for stamp in STAMPS_NS]
        write_text(folder / "data.csv", "\n".join(f"{s},{s}.png" for s in ["#t", *stamps][1:]))
        for i, stamp in enumerate(stamps):
            write_image(folder / "data" / f"{stamp}.png", camera(i, n))
    return root


def frames_of(path: Path, calibration: Path, **given: Any) -> list[Frame]:
    return list(open_source(path, calibration=calibration, **given).frames())


@pytest.mark.parametrize("by_imu", [False, True])
def test_kalibr_and_openvins_chains_of_four(tmp_path: Path, by_imu: bool) -> None:
    file = tmp_path / "camchain.yaml"
    file.write_text(yaml.safe_dump(kalibr(4, by_imu)), encoding="utf-8")
    rig = read_calibration(file).rig
    assert len(rig.cameras) == 4
    expected = inverse(BODY_FROM_CAMS[0]) @ BODY_FROM_CAMS
    np.testing.assert_allclose(rig.cam0_from_cams, expected, atol=1e-9)


@pytest.mark.parametrize("name", ["car", "robot", "drone"])
def test_presets_survive_our_own_format(tmp_path: Path, name: str) -> None:
    rig = load_rig(name)
    assert len(rig.cameras) == {"car": 6, "robot": 4, "drone": 2}[name]
    write_calibration(tmp_path / "rig.yaml", rig)
    again = read_calibration(tmp_path / "rig.yaml").rig
    assert again.cameras == rig.cameras
    np.testing.assert_allclose(again.cam0_from_cams, rig.cam0_from_cams, atol=1e-12)


def test_euroc_sensor_files_of_four(tmp_path: Path) -> None:
    path = write_mav(tmp_path / "log", 4)
    for n, pose in enumerate(BODY_FROM_CAMS):
        section = {"T_BS": {"rows": 4, "cols": 4, "data": pose.ravel().tolist()}, **LENS}
        section |= {"distortion_model": "radial-tangential", "distortion_coefficients": [0] * 4}
        file = path / "mav0" / f"cam{n}" / "sensor.yaml"
        file.write_text(yaml.safe_dump(section), encoding="utf-8")
    source = open_source(path)
    frames = list(source.frames())
    assert len(source.rig.cameras) == 4 and len(frames) == len(STAMPS_NS)
    for i, frame in enumerate(frames):
        assert [each is not None and int(each[0, 1]) for each in frame.images] == [0, 1, 2, 3]
        assert all(each is not None and each[0, 0] == i for each in frame.images)
        assert frame.stamps_ns is None
    np.testing.assert_allclose(
        source.rig.cam0_from_cams, inverse(BODY_FROM_CAMS[0]) @ BODY_FROM_CAMS, atol=1e-9
    )


def test_cameras_without_common_trigger_keep_their_stamps(tmp_path: Path) -> None:
    path = write_mav(tmp_path / "log", 4, late_ms=10.0)
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(kalibr(4)), encoding="utf-8")
    for frame in frames_of(path, tmp_path / "chain.yaml"):
        assert frame.stamps_ns == tuple(frame.stamp_ns + n * 10_000_000 for n in range(4))
        assert all(each is not None and each[0, 0] == frame.index for each in frame.images)


@pytest.mark.parametrize("mode, count", [("mono", 1), ("stereo", 2)])
def test_modes_use_the_first_cameras_only(tmp_path: Path, mode: Any, count: int) -> None:
    path = write_mav(tmp_path / "log", 4)
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(kalibr(4)), encoding="utf-8")
    source = open_source(path, calibration=tmp_path / "chain.yaml", mode=mode)
    assert len(source.rig.cameras) == count
    assert all(len(frame.images) == 2 for frame in source.frames())


def test_a_chain_of_four_for_two_folders_is_a_pair(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_mav(tmp_path / "log", 2)
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(kalibr(4)), encoding="utf-8")
    source = open_source(path, calibration=tmp_path / "chain.yaml")
    assert len(source.rig.cameras) == 2 and not caplog.records


def test_a_chain_of_five_for_four_folders_says_that_one_has_no_images(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_mav(tmp_path / "log", 4)
    chain = kalibr(4)
    chain["cam4"] = chain["cam3"] | {"T_cn_cnm1": np.diag([-1.0, 1.0, -1.0, 1.0]).tolist()}
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(chain), encoding="utf-8")
    source = open_source(path, calibration=tmp_path / "chain.yaml")
    assert len(source.rig.cameras) == 4
    (said,) = [record.getMessage() for record in caplog.records]
    assert said.endswith("log: the calibration has 5 cameras, but the last has no images")


def test_missing_folder_and_uncalibrated_folders_are_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(kalibr(4)), encoding="utf-8")
    path = write_mav(tmp_path / "gap", 4, missing=2)
    frames = frames_of(path, tmp_path / "chain.yaml")
    assert "there are no images of cam2, which is calibrated" in caplog.text
    assert all(frame.images[2] is None and frame.images[3] is not None for frame in frames)
    caplog.clear()
    (tmp_path / "three.yaml").write_text(yaml.safe_dump(kalibr(3)), encoding="utf-8")
    source = open_source(write_mav(tmp_path / "four", 4), calibration=tmp_path / "three.yaml")
    assert len(source.rig.cameras) == 3
    assert "images of cam3 are not used, because the calibration has only 3" in caplog.text


def test_plain_folders_with_times_beside_them(tmp_path: Path) -> None:
    for n in range(3):
        for i in range(len(STAMPS_NS)):
            write_image(tmp_path / "log" / f"cam{n}" / f"{i:06d}.png", camera(i, n))
    write_text(tmp_path / "log" / "times.txt", "\n".join(str(1e-9 * s) for s in STAMPS_NS))
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(kalibr(3)), encoding="utf-8")
    frames = frames_of(tmp_path / "log", tmp_path / "chain.yaml")
    assert len(frames) == len(STAMPS_NS) and all(len(frame.images) == 3 for frame in frames)


def write_kitti(root: Path) -> Path:
    for n in range(4):
        for i in range(len(STAMPS_NS)):
            write_image(root / f"image_{n}" / f"{i:06d}.png", camera(i, n))
    write_text(root / "times.txt", "\n".join(f"{0.1 * i:e}" for i in range(len(STAMPS_NS))))
    for n, shift in enumerate((0.0, -25.0, 1.0, -24.0)):
        row = f"P{n}: 50 0 31.5 {shift} 0 50 23.5 0 0 0 1 0\n"
        with (root / "calib.txt").open("a", encoding="utf-8") as file:
            file.write(row)
    return root


def test_kittis_grey_and_colour_pair_stay_a_pair(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_kitti(tmp_path / "00")
    source = open_source(path)
    assert len(source.rig.cameras) == 2 and not caplog.records
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(kalibr(4)), encoding="utf-8")
    assert len(open_source(path, calibration=tmp_path / "chain.yaml").rig.cameras) == 4


def broken(change: str) -> dict[str, Any]:
    rig = {"cam0": LENS, "cam1": LENS, "cam2": LENS}
    rig |= {f"cam{n}_from_cam0": inverse(BODY_FROM_CAMS[n]).tolist() for n in (1, 2)}
    if change == "gap":
        rig["cam4"], rig["cam4_from_cam0"] = LENS, np.eye(4).tolist()
    elif change == "twice":
        rig["cam2_from_cam0"] = rig["cam1_from_cam0"]
    elif change == "no pose":
        del rig["cam2_from_cam0"]
    else:
        rig["cam2_from_cam0"] = (np.diag([1, 1, -1, 1]) @ BODY_FROM_CAMS[2]).tolist()
    return rig


@pytest.mark.parametrize(
    "change, message",
    [
        ("gap", "cam3 is missing, but there is cam4_from_cam0"),
        ("twice", "cam1 and cam2 have the same pose"),
        ("no pose", "cam2_from_cam0 is missing, but there is cam2"),
        ("mirror", "cam2_from_cam0.*rotation"),
    ],
)
def test_bad_rigs_have_one_clear_line(tmp_path: Path, change: str, message: str) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(yaml.safe_dump(broken(change)), encoding="utf-8")
    with pytest.raises(CalibrationError, match=message) as raised:
        read_calibration(file)
    assert "\n" not in str(raised.value)


def test_first_cameras_of_a_rig() -> None:
    rig = load_rig("car")
    assert rig.first(6) is rig and rig.first(2).cameras == rig.cameras[:2]
    assert len(rig.first(1).cameras) == 1
    np.testing.assert_array_equal(rig.first(4).cam0_from_cams, rig.cam0_from_cams[:4])
