"""Layouts of nuScenes and KITTI-360, with the keys and lines of their real files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from layouts import HEIGHT, WIDTH, image, write_image, write_text

from vo.base.errors import SourceError
from vo.base.geometry.transforms import inverse, quat_xyzw_from_rotation, se3_exp
from vo.base.types import Floats
from vo.recordings.sources.registry import open_source

CHANNELS = (
    "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT", "CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT",
)  # fmt: skip
ORDER = (3, 5, 4, 2, 1, 0)
BODY_FROM_CAMS = [se3_exp(np.array([0.1, 1.0 * i, 0.2, 1.5, 0.2 * i, 1.6])) for i in range(6)]
FRAMES = 4


def posed(pose: Floats) -> dict[str, Any]:
    x, y, z, w = quat_xyzw_from_rotation(pose[:3, :3]).tolist()
    return {"translation": pose[:3, 3].tolist(), "rotation": [w, x, y, z]}


def ego(index: int) -> Floats:
    return se3_exp(np.array([0.0, 0.0, 0.1 * index, 600.0 + index, 1600.0, 0.0]))


def write_nuscenes(root: Path) -> Path:
    """Two scenes; cameras of the first are 8 ms apart, as the lidar passes them."""
    k = [[50.0, 0.0, 31.5], [0.0, 51.0, 23.5], [0.0, 0.0, 1.0]]
    tables: dict[str, list[dict[str, Any]]] = {
        "scene": [{"token": f"s{n}", "name": f"scene-006{n}"} for n in (1, 2)],
        "sample": [{"token": f"k{n}", "scene_token": f"s{n}", "timestamp": n} for n in (1, 2)],
        "sensor": [{"token": f"c{n}", "channel": name, "modality": "camera"}
                   for n, name in enumerate(CHANNELS)],
        "calibrated_sensor": [
            {"token": f"m{n}", "sensor_token": f"c{n}", "camera_intrinsic": k, **posed(pose)}
            for n, pose in enumerate(BODY_FROM_CAMS)
        ],
        "ego_pose": [], "sample_data": [],
    }  # fmt: skip
    tables["sensor"].append({"token": "l", "channel": "LIDAR_TOP", "modality": "lidar"})
    tables["calibrated_sensor"].append({"token": "ml", "sensor_token": "l", "camera_intrinsic": []})
    tables["sample_data"].append(
        {"token": "d", "sample_token": "k1", "calibrated_sensor_token": "ml", "timestamp": 5}
    )
    for index in range(FRAMES):
        for n, channel in enumerate(CHANNELS):
            stamp = 1_532_402_927_604_844 + 83_000 * index + 8_000 * ORDER.index(n)
            name = f"{'samples' if index == 0 else 'sweeps'}/{channel}/n015__{channel}__{stamp}.jpg"
            token = f"e{index}{n}"
            tables["ego_pose"].append({"token": token, "timestamp": stamp, **posed(ego(index))})
            tables["sample_data"].append(
                {"token": f"d{index}{n}", "sample_token": "k1", "ego_pose_token": token,
                 "calibrated_sensor_token": f"m{n}", "timestamp": stamp, "fileformat": "jpg",
                 "is_key_frame": index == 0, "height": HEIGHT, "width": WIDTH, "filename": name}
            )  # fmt: skip
            write_image(root / name, image(n))
    for name, rows in tables.items():
        write_text(root / "v1.0-mini" / f"{name}.json", json.dumps(rows[::-1]))
    return root / "v1.0-mini"


def test_a_scene_of_nuscenes(tmp_path: Path) -> None:
    tables = write_nuscenes(tmp_path)
    source = open_source(tables / "scene-0061")
    assert source.name == "scene-0061" and len(source.rig.cameras) == 6
    expected = inverse(BODY_FROM_CAMS[3]) @ np.stack([BODY_FROM_CAMS[n] for n in ORDER])
    np.testing.assert_allclose(source.rig.cam0_from_cams, expected, atol=1e-9)
    frames = list(source.frames())
    assert len(frames) == FRAMES
    for frame in frames:
        assert frame.stamps_ns is not None
        assert np.diff(frame.stamps_ns).tolist() == [8_000_000] * 5
        assert all(each is not None for each in frame.images)
    truth = source.ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth.world_from_cam[2], ego(2) @ BODY_FROM_CAMS[3], atol=1e-9)


def test_scenes_of_nuscenes_are_listed(tmp_path: Path) -> None:
    tables = write_nuscenes(tmp_path)
    with pytest.raises(SourceError, match="several scenes: scene-006.*give one, such as .*scene"):
        open_source(tables)
    with pytest.raises(SourceError, match="no scene scene-0099: "):
        open_source(tables / "scene-0099")
    (tables / "ego_pose.json").write_text("[{}]", encoding="utf-8")
    with pytest.raises(SourceError, match="a table is damaged or incomplete"):
        open_source(tables / "scene-0061")


TURN = se3_exp(np.array([0.01, -0.005, 0.002, 0, 0, 0]))
MEI = f"""%YAML:1.0
---
model_type: MEI
camera_name: image_02
image_width: {WIDTH}
image_height: {HEIGHT}
mirror_parameters:
   xi: 2.2134047507854890e+00
distortion_parameters:
   k1: 1.6798235660113681e-02
   k2: 1.6548773243373522e+00
   p1: 4.2223943394772046e-04
   p2: 4.2462134260997584e-04
projection_parameters:
   gamma1: 80.0
   gamma2: 80.0
   u0: 31.5
   v0: 23.5
"""


def row(values: Floats) -> str:
    return " ".join(f"{value:.12e}" for value in values.ravel())


def write_kitti_360(root: Path, numbers: Sequence[int] = (0, 1, 3)) -> Path:
    drive = root / "data_2d_raw" / "2013_05_28_drive_0000_sync"
    for n, inside in enumerate(("data_rect", "data_rect", "data_rgb", "data_rgb")):
        for i in numbers:  # some images are missing
            write_image(drive / f"image_{n:02d}" / inside / f"{i:010d}.png", image(i))
        lines = [f"2013-05-28 08:46:02.{100 * i:03d}352768" for i in range(5)]
        write_text(drive / f"image_{n:02d}" / "timestamps.txt", "\n".join(lines))
    k = np.array([[50.0, 0, 31.5, 0], [0, 50, 23.5, 0], [0, 0, 1, 0]])
    right = k + np.array([[0, 0, 0, -50.0 * 0.6], [0, 0, 0, 0], [0, 0, 0, 0]])
    text = "calib_time: 25-Feb-2014 17:23:33\ncorner_dist: 1.300000e-01\n"
    for n, p in enumerate((k, right)):
        text += f"S_{n:02d}: 1392 512\nS_rect_{n:02d}: {WIDTH} {HEIGHT}\n"
        text += f"R_rect_{n:02d}: {row(TURN[:3, :3])}\nP_rect_{n:02d}: {row(p)}\n"
    write_text(root / "calibration" / "perspective.txt", text)
    lines = [f"image_{n:02d}: {row(BODY_FROM_CAMS[n][:3])}" for n in range(4)]
    write_text(root / "calibration" / "calib_cam_to_pose.txt", "\n".join(lines))
    for n in (2, 3):
        write_text(root / "calibration" / f"image_{n:02d}.yaml", MEI)
    poses = "\n".join(f"{i} {row(ego(i)[:3])}" for i in (0, 3))
    write_text(root / "data_poses" / drive.name / "poses.txt", poses)
    return drive


def test_a_drive_of_kitti_360(tmp_path: Path) -> None:
    source = open_source(write_kitti_360(tmp_path))
    rig = source.rig
    assert [camera.distortion_model for camera in rig.cameras] == ["none", "none", "omni", "omni"]
    body_from_cam0 = BODY_FROM_CAMS[0] @ inverse(TURN)
    np.testing.assert_allclose(rig.cam0_from_cams[1, :3, 3], [0.6, 0, 0], atol=1e-9)
    for n in (2, 3):
        expected = inverse(body_from_cam0) @ BODY_FROM_CAMS[n]
        np.testing.assert_allclose(rig.cam0_from_cams[n], expected, atol=1e-9)
    frames = list(source.frames())
    assert [frame.image0[0, 0] for frame in frames] == [0, 1, 3]
    assert frames[2].stamp_ns - frames[0].stamp_ns == 300_000_000
    assert source.ground_truth is not None
    np.testing.assert_allclose(
        source.ground_truth.world_from_cam[1], ego(3) @ body_from_cam0, atol=1e-8
    )


def test_kitti_360_without_calibration_says_what_to_get(tmp_path: Path) -> None:
    drive = write_kitti_360(tmp_path)
    (tmp_path / "calibration").rename(tmp_path / "elsewhere")
    with pytest.raises(Exception, match="no folder calibration beside") as raised:
        open_source(drive)
    assert "\n" not in str(raised.value)
