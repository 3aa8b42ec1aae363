"""Basalt's calibration.json."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from calibration_files import BASALT, basalt_file, cam1_from_cam0, read, read_error

from vo.base.geometry.transforms import inverse, so3_exp


@pytest.mark.parametrize("lens", BASALT)
def test_basalt(tmp_path: Path, lens: str) -> None:
    values, model, coefficients = BASALT[lens]
    calibration = read(tmp_path, basalt_file(lens, values), "calibration.json")
    assert calibration.kind == "Basalt"
    rig = calibration.rig
    assert (rig.cam0.distortion_model, rig.cam0.distortion) == (model, coefficients)
    assert (rig.cam0.width, rig.cam0.fx, rig.cam0.cy) == (512, 158.28, 256.89)
    assert calibration.body_from_cam0 is not None
    np.testing.assert_allclose(calibration.body_from_cam0[:3, 3], [0.1, 0.2, 0.3])
    # T_imu_cam of cam1: 10 cm along x, rotated by 1 degree about y.
    place = inverse(cam1_from_cam0(rig))
    np.testing.assert_allclose(place[:3, 3], [0.1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(place[:3, :3], so3_exp(np.deg2rad([0.0, 1.0, 0.0])), atol=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"ds"', '"ftheta"', "camera_type 'ftheta' is not supported; supported are pinhole"),
        ('"alpha": 0.593', '"alpha": 1.5', "alpha is 1.5; for double_sphere it must be"),
        ('"alpha"', '"beta"', "alpha is None; it must be a finite"),
        ('"qw": 1}', '"qw": 0}', "the quaternion has length 0, not 1"),
        ('"px": 0.2', '"px": 0.1', "T_imu_cam: the baseline is 0 m"),
        ("[512, 512], ", "[512], ", "has 1 numbers; 2 are needed"),
        ('"T_imu_cam": [', '"T_imu_cam": 5, "other": [', "T_imu_cam is 5; it must be a list"),
    ],
)  # fmt: skip
def test_error_for_implausible_basalt_files(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    text = basalt_file("ds", BASALT["ds"][0])
    assert old in text
    assert expected in read_error(tmp_path, text.replace(old, new), "calibration.json")
