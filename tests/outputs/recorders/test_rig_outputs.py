"""Outputs of rigs: COLMAP's rigs and frames, and poses of each camera at its own times."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import exact_run
import numpy as np
import pytest

from data_synth.cameras import load_rig
from vo.base.geometry.transforms import inverse, se3_exp
from vo.base.records.posed_frames import PosedFrames
from vo.base.records.snapshot import FurtherImage, Snapshot
from vo.base.types import Trajectory
from vo.outputs.recorders.colmap import ColmapRecorder
from vo.runs.camera_poses import camera_pose_lines

CAM0_FROM_OTHERS = [se3_exp(np.array([0.01, 0.8 * n, 0.02, 0.2 * n, 0.01, -0.1])) for n in (1, 2)]


def snapshot(frame: int) -> Snapshot:
    """As of one camera, with two more, the second of which misses frame 3."""
    shown = exact_run.snapshot(frame)
    further = tuple(
        FurtherImage(f"cam{n}", None if (n, frame) == (2, 3) else shown.view.image0 // n, pose)
        for n, pose in enumerate(CAM0_FROM_OTHERS, start=1)
    )
    return replace(shown, view=replace(shown.view, further=further))


def test_colmap_reads_a_rig_with_all_images(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    recorder = ColmapRecorder(tmp_path)
    recorder.begin("a rig", load_rig("car"), None)
    for frame in range(exact_run.FRAMES):
        recorder.record(exact_run.estimate(frame), partial(snapshot, frame))
    recorder.finish(exact_run.smoothed(), exact_run.smoothed())
    model = pycolmap.Reconstruction(str(tmp_path / "sparse" / "0"))
    assert len(model.cameras) == 3 and len(model.rigs) == 1
    assert len(model.frames) == exact_run.FRAMES
    assert model.num_images() == 3 * exact_run.FRAMES - 1
    for image in model.images.values():
        folder, _, name = image.name.rpartition("/")
        number = int(name.removeprefix("frame_").removesuffix(".png"))
        cam0_from_image = exact_run.CAM0_FROM_IMAGE0
        if folder:
            cam0_from_image = CAM0_FROM_OTHERS[int(folder[-1]) - 1]
        expected = inverse(exact_run.pose(number) @ cam0_from_image)[:3]
        np.testing.assert_allclose(image.cam_from_world().matrix(), expected, atol=1e-9)
        assert image.num_points3D > 50 or folder
        shown = cv2.imread(str(tmp_path / "images" / image.name), cv2.IMREAD_GRAYSCALE)
        assert shown is not None and shown.shape == (120, 160)


def test_each_camera_has_the_pose_of_its_own_time() -> None:
    moving = np.tile(np.eye(4), (3, 1, 1))
    moving[:, 0, 3] = (0.0, 1.0, 3.0)
    stamps = np.array([0, 100, 200], dtype=np.int64)
    flags = np.zeros(3, dtype=bool)
    path = PosedFrames(
        np.array([4, 5, 6]), np.zeros(3, int), np.zeros(3, int), flags, flags,
        Trajectory(stamps, moving),
    )  # fmt: skip
    aside = np.eye(4)
    aside[1, 3] = 0.5
    images = [(0, 0)] * 4 + [(0, 20), (100, 90), (200, 230)]
    lines = list(camera_pose_lines(path, {"cam0": np.eye(4), "cam1": aside}, images))
    assert [line.split(",")[:3] for line in lines[:2]] == [["4", "0", "cam0"], ["4", "20", "cam1"]]
    of_cam1 = [[float(text) for text in line.split(",")[3:6]] for line in lines[1::2]]
    # Between its frames by its time, and at the last frame where nothing follows.
    np.testing.assert_allclose(of_cam1, [[0.2, 0.5, 0], [0.9, 0.5, 0], [3.0, 0.5, 0]], atol=1e-9)
    together = list(camera_pose_lines(path, {"cam0": np.eye(4), "body": aside}, None))
    assert together[1].startswith("4,0,body,0") and len(together) == 6
