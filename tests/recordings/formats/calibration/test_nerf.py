"""NeRF's transforms.json: the camera and the poses of the images."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from calibration_files import read, read_error, write_file
from foreign_files import nerf

from vo.base.errors import SourceError
from vo.base.types import Camera
from vo.recordings.formats.calibration.nerf import read_nerf_poses


def test_camera_of_instant_ngp(tmp_path: Path) -> None:
    calibration = read(tmp_path, nerf(), "transforms.json")
    assert calibration.kind == "NeRF"
    assert calibration.rig.cam0 == Camera(
        640, 480, 460.5, 461.5, 320.0, 240.5, "radtan", (0.04, -0.05, 0.001, -0.002)
    )


def test_camera_of_nerfstudio(tmp_path: Path) -> None:
    radial = {"k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4, "p1": 0.0, "p2": 0.0}
    text = nerf(camera_model="OPENCV_FISHEYE", **radial)
    cam0 = read(tmp_path, text).rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == ("equidistant", (0.1, 0.2, 0.3, 0.4))
    assert "k4 is 0.4; it must be 0" in read_error(tmp_path, nerf(**radial))
    cam0 = read(tmp_path, nerf(k4=0.0, k3=0.01)).rig.cam0
    assert cam0.distortion == (0.04, -0.05, 0.001, -0.002, 0.01)


def test_camera_of_blender(tmp_path: Path) -> None:
    """Only a field of view; size and principal point are those of the images."""
    frames = [{"file_path": "./train/r_0", "rotation": 0.1, "transform_matrix": np.eye(4).tolist()}]
    text = json.dumps({"camera_angle_x": 0.6911112070083618, "frames": frames})
    cam0 = read(tmp_path, text, size=(800, 600)).rig.cam0
    focal = 400.0 / math.tan(0.5 * 0.6911112070083618)
    assert cam0 == Camera(800, 600, focal, focal, 399.5, 299.5)
    assert "the size of the images is missing; add w and h" in read_error(tmp_path, text)


def test_intrinsics_beside_each_frame(tmp_path: Path) -> None:
    data = json.loads(nerf())
    for frame in data["frames"]:
        frame["fl_x"] = data["fl_x"]
    del data["fl_x"]
    assert read(tmp_path, json.dumps(data)).rig.cam0.fx == 460.5
    data["frames"][1]["fl_x"] = 470.0
    assert "the frames have different cameras (fl_x)" in read_error(tmp_path, json.dumps(data))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, "camera_model 'EQUIRECTANGULAR' is not supported"),
        ({"fl_x": float("nan")}, "fl_x is nan"),
        ({"fl_x": -460.0}, "focal length is -460, 461.5"),
        ({"fl_x": None, "camera_angle_x": None}, "fl_x is missing"),
        ({"fl_x": None, "camera_angle_x": 3.3}, "camera_angle_x is 3.3; it is a field of view"),
        ({"cx": 32050.0}, "principal point"),
    ],
)
def test_errors_of_the_camera(tmp_path: Path, changes: dict[str, object], expected: str) -> None:
    message = read_error(tmp_path, nerf(**changes))
    assert expected in message
    assert message.endswith("(read as NeRF calibration)")


def test_poses_are_those_of_a_camera_with_z_forward(tmp_path: Path) -> None:
    data = json.loads(nerf())
    # Looks along the world's x, with the world's z up: right is -y, up is z, back is -x.
    data["frames"][1]["transform_matrix"] = [
        [0.0, 0.0, -1.0, 4.0], [-1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, 6.0], [0.0, 0.0, 0.0, 1.0],
    ]  # fmt: skip
    images = read_nerf_poses(write_file(tmp_path, json.dumps(data), "transforms.json"))
    assert [image.name for image in images] == [f"./images/{i:04d}.png" for i in range(3)]
    expected = [[0, 0, 1, 4], [-1, 0, 0, 5], [0, -1, 0, 6], [0, 0, 0, 1]]
    np.testing.assert_allclose(images[0].world_from_cam, expected)
    np.testing.assert_allclose(images[2].world_from_cam[:3, 3], [0.2, 0.4, 0.6])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"transform_matrix"', '"matrix"', "frame 0: transform_matrix is missing"),
        ('"file_path"', '"path"', "frame 0: file_path is missing"),
        ('"frames"', '"images"', "has no list `frames` with poses"),
        ("      1.0,\n", "      2.0,\n", "frame 0: transform_matrix: the rotation is not"),
        ("]\n}", "", "is not JSON"),
    ],
)
def test_errors_of_poses(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = nerf()
    path = write_file(tmp_path, text.replace(old, new), "transforms.json")
    with pytest.raises(SourceError) as caught:
        read_nerf_poses(path)
    assert expected in str(caught.value) and "\n" not in str(caught.value)


def test_thousands_of_poses_in_one_line(tmp_path: Path) -> None:
    data = json.loads(nerf())
    data["frames"] *= 700
    path = write_file(tmp_path, json.dumps(data), "transforms.json")
    assert path.stat().st_size > 300_000
    assert len(read_nerf_poses(path)) == 2100
    path = write_file(tmp_path, json.dumps(data, indent=4)[:-9], "transforms.json")
    assert path.stat().st_size > 1_000_000
    with pytest.raises(SourceError, match="is not JSON"):
        read_nerf_poses(path)
