"""The same stereo pair in three formats, and warnings for implausible intrinsics."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from calibration_files import (
    CAM1_FROM_CAM0,
    D0,
    D1,
    EXTRINSICS,
    INTRINSICS,
    K0,
    K1,
    cam1_from_cam0,
    camera_info,
    flat_list,
    read,
    rectification,
    write_file,
    write_storage,
)

from vo.base.geometry.cameras import distort, normalise, project
from vo.base.geometry.transforms import transform_points
from vo.recordings.formats.calibration import read_calibration


def test_same_pair_in_three_formats(tmp_path: Path) -> None:
    r0, r1, p0, p1 = rectification()
    left = write_file(tmp_path, camera_info(K0, D0, r0, p0), "left.yaml")
    write_file(tmp_path, camera_info(K1, D1, r1, p1), "right.yaml")
    opencv = INTRINSICS | EXTRINSICS | {"image_width": 640, "image_height": 480}
    rows = "".join(f"  - {flat_list(row)}\n" for row in CAM1_FROM_CAM0)
    kalibr = "".join(
        f"cam{i}:\n  camera_model: pinhole\n  resolution: [640, 480]\n  distortion_model: radtan5\n"
        f"  intrinsics: {flat_list([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])}\n"
        f"  distortion_coeffs: {flat_list(d)}\n"
        for i, (k, d) in enumerate(((K0, D0), (K1, D1)))
    )
    files = [
        left,
        write_storage(tmp_path / "stereo.xml", opencv),
        write_file(tmp_path, f"{kalibr}  T_cn_cnm1:\n{rows}", "camchain.yaml"),
    ]
    points = np.random.default_rng(0).uniform((-1, -1, 2), (1, 1, 6), (50, 3))
    expected = [
        cv2.projectPoints(points, np.zeros(3), np.zeros(3), K0, np.array(D0))[0].reshape(-1, 2),
        cv2.projectPoints(
            points, cv2.Rodrigues(CAM1_FROM_CAM0[:3, :3].copy())[0], CAM1_FROM_CAM0[:3, 3], K1,
            np.array(D1),
        )[0].reshape(-1, 2),
    ]  # fmt: skip
    for file in files:
        rig = read_calibration(file).rig
        assert rig.cam1 is not None
        np.testing.assert_allclose(project(rig.cam0, points), expected[0], atol=1e-8)
        in_cam1 = transform_points(cam1_from_cam0(rig), points)
        np.testing.assert_allclose(project(rig.cam1, in_cam1), expected[1], atol=1e-6)
        np.testing.assert_allclose(
            distort(rig.cam0, normalise(rig.cam0, expected[0])), expected[0], atol=1e-9
        )


@pytest.mark.parametrize(
    ("intrinsics", "expected"),
    [
        (
            "[250, 250, 160, 120]",
            "is the centre of images of about 321x241, and these have 640x480",
        ),
        ("[500, 500, -20, 240]", "principal point (-20, 240) is outside the 640x480 image"),
        ("[40, 40, 320, 240]", "field of view of 166 degrees; check the unit"),
        ("[20000, 20000, 320, 240]", "field of view of 1.83 degrees"),
        ("[500, 500, 320, 240]", ""),
    ],
)
def test_warning_for_implausible_intrinsics(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, intrinsics: str, expected: str
) -> None:
    read(tmp_path, f"cam0: {{resolution: [640, 480], intrinsics: {intrinsics}}}")
    assert expected in caplog.text
    assert bool(caplog.records) == bool(expected)
