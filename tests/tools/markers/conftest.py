"""A camera, and a recording with a marker whose pose is known."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from marker_views import Placed, render

from vo.base.geometry.transforms import inverse, make_transform, so3_exp
from vo.base.types import Camera, Floats
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source

_FACING = so3_exp(np.array([np.pi, 0.0, 0.0]))  # towards a camera that looks along z
_HANGING = make_transform(_FACING @ so3_exp(np.array([0.3, 0.4, 0.1])), np.array([0.0, 0.0, 1.6]))


@pytest.fixture
def camera() -> Camera:
    return Camera(640, 480, 600.0, 600.0, 319.5, 239.5)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


@pytest.fixture(scope="session")
def hanging() -> Floats:
    """Pose of the marker in the camera of the middle frame."""
    return _HANGING


@pytest.fixture(scope="session")
def with_marker(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The walk, with a marker that hangs in front of the camera for all of its three seconds."""
    folder = tmp_path_factory.mktemp("marked") / "walk"
    shutil.copytree(synthetic_stereo, folder)
    recording = open_source(synthetic_stereo, mode="mono")
    truth = read_tum(synthetic_stereo / "groundtruth.tum")
    camera = recording.rig.cam0
    middle = truth.world_from_cam[len(truth) // 2]
    world_from_marker = middle @ _HANGING
    files = sorted((folder / "mav0" / "cam0" / "data").glob("*.png"))
    assert len(files) == len(truth)
    for path, world_from_cam in zip(files, truth.world_from_cam, strict=True):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        pose = inverse(world_from_cam) @ world_from_marker
        if pose[2, 3] > 0.4:
            placed = Placed("4X4_50", 7, 0.16, pose)
            levels = cv2.GaussianBlur(render(camera, placed, image), (0, 0), 0.5)
            image = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        cv2.imwrite(str(path), image)
    return folder
