"""The next pose from how the last frame's landmarks looked, without any feature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from vo.config import load_config
from vo.formats.trajectory import read_tum
from vo.frontend.camera_alignment import smaller_images
from vo.frontend.preprocessing import FramePreprocessor, PreprocessedFrame
from vo.geometry.rectification import RectifiedRig, rectified_rig
from vo.geometry.transforms import inverse, rotation_angle, se3_exp, transform_points
from vo.mapping.keyframes import add_keyframe
from vo.mapping.local_map import Map
from vo.mapping.triangulate_stereo import triangulate_stereo
from vo.snapshot import LastFrame
from vo.sources.registry import open_source
from vo.tracking.sparse_image_alignment import sparse_image_alignment
from vo.tracking.tracker import as_tracked_frame
from vo.types import Bytes, Floats

CONFIG = load_config("fast")


@dataclass(frozen=True, eq=False)
class Scene:
    """A map from one stereo frame, what that sees, a later frame, and its true pose."""

    map: Map
    rig: RectifiedRig
    last: LastFrame
    frame: PreprocessedFrame
    pose: Floats

    def step(self, predicted: Floats, frame: PreprocessedFrame | None = None) -> Floats | None:
        frame = frame or self.frame
        return sparse_image_alignment(self.map, self.last, np.eye(4), frame, predicted, self.rig)

    def showing(self, image: Bytes) -> PreprocessedFrame:
        return replace(self.frame, image0=image, smaller=smaller_images(image))


@pytest.fixture(scope="module")
def scene(synthetic_stereo: Path) -> Scene:
    source = open_source(synthetic_stereo)
    rig, preparation = rectified_rig(source.rig), FramePreprocessor(CONFIG, threads=1)
    preparation.begins_features = False
    first, later = (preparation.later(f, rig).result() for f in source.frames(0, 4, 2))
    world = Map(4, rig.height, rig.width)
    free = np.ones(len(first.keypoints), dtype=bool)
    keyframe = add_keyframe(world, first, np.eye(4), 0, free, rig)
    triangulate_stereo(world, keyframe, first, rig, CONFIG)
    seen = as_tracked_frame(world, keyframe)
    last = LastFrame(first, seen.ids, seen.observed.image_xy, seen.inlier)
    true = read_tum(synthetic_stereo / "groundtruth.tum").world_from_cam
    return Scene(world, rig, last, later, inverse(true[0]) @ true[2])


@pytest.mark.parametrize("degrees", [0.0, 1.5, -1.5])
def test_pose_is_found_from_a_prediction_many_pixels_off(scene: Scene, degrees: float) -> None:
    turn = se3_exp(np.array([0.0, np.deg2rad(degrees), 0.0, 0.0, 0.0, 0.0]))
    found = scene.step(scene.pose @ turn)
    assert found is not None
    away = inverse(scene.pose) @ found
    assert np.linalg.norm(away[:3, 3]) < 0.01
    assert np.rad2deg(rotation_angle(away[:3, :3])) < 0.06


def test_the_step_is_the_same_when_smoothing_has_moved_everything(scene: Scene) -> None:
    motion = se3_exp(np.array([0.02, -0.3, 0.01, 0.4, 0.1, -0.2]))
    before = scene.map.xyz.copy()
    scene.map.xyz = transform_points(motion, before)
    predicted = motion @ scene.pose
    moved = sparse_image_alignment(scene.map, scene.last, motion, scene.frame, predicted, scene.rig)
    scene.map.xyz = before
    step = scene.step(scene.pose)
    assert step is not None and moved is not None
    np.testing.assert_allclose(moved, step, atol=1e-5)


def test_no_feature_is_looked_for(scene: Scene) -> None:
    scene.step(scene.pose)
    assert not scene.frame.left.is_used
    assert len(scene.frame.used_keypoints_xy) == 0


def test_another_scene_or_none_gives_no_pose(scene: Scene) -> None:
    image = scene.frame.image0
    assert scene.step(scene.pose, scene.showing(np.zeros_like(image))) is None
    upside_down = np.ascontiguousarray(image[::-1, ::-1])
    assert scene.step(scene.pose, scene.showing(upside_down)) is None


def test_too_few_landmarks_give_no_pose(scene: Scene) -> None:
    few = LastFrame(scene.last.frame, *(part[:15] for part in scene.last[1:]))
    assert replace(scene, last=few).step(scene.pose) is None
