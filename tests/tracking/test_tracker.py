"""Whether patches confirm a first pose."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from vo.config import Config, load_config
from vo.formats.trajectory import read_tum
from vo.frontend.preprocessing import FramePreprocessor, PreprocessedFrame
from vo.geometry.rectification import RectifiedRig, rectified_rig
from vo.geometry.transforms import inverse, rotation_angle, se3_exp
from vo.mapping.keyframes import add_keyframe
from vo.mapping.local_map import Map
from vo.mapping.triangulate_stereo import triangulate_stereo
from vo.sources.registry import open_source
from vo.tracking.tracker import TrackedFrame, refine
from vo.types import Floats

CONFIG = load_config("fast")


@dataclass(frozen=True, eq=False)
class Scene:
    """A map from one stereo frame, a later frame, and its true pose in the map."""

    map: Map
    rig: RectifiedRig
    frame: PreprocessedFrame
    pose: Floats

    def refine(self, pose: Floats, config: Config = CONFIG) -> TrackedFrame | None:
        return refine(self.map, self.frame, pose, self.rig, config)

    def with_landmarks(self, count: int) -> Scene:
        world = deepcopy(self.map)
        tracked = self.refine(self.pose)
        assert tracked is not None
        chosen = tracked.ids[tracked.inlier]
        world.keep_landmarks(np.isin(world.id, chosen[:: len(chosen) // count][:count]))
        return replace(self, map=world)

    def with_dark_rows(self, count: int) -> Scene:
        image = self.frame.image0.copy()
        image[:count] = 0
        return replace(self, frame=replace(self.frame, image0=image))


@pytest.fixture(scope="module")
def scene(synthetic_stereo: Path) -> Scene:
    source = open_source(synthetic_stereo)
    rig, preparation = rectified_rig(source.rig), FramePreprocessor(CONFIG, threads=1)
    first, later = (preparation.later(f, rig).result() for f in source.frames(0, 4, 2))
    world = Map(4, rig.height, rig.width)
    free = np.ones(len(first.keypoints), dtype=bool)
    keyframe = add_keyframe(world, first, np.eye(4), 0, free, rig)
    assert triangulate_stereo(world, keyframe, first, rig, CONFIG) > 200
    true = read_tum(synthetic_stereo / "groundtruth.tum").world_from_cam
    return Scene(world, rig, later, inverse(true[0]) @ true[2])


def _turn(axis: int, degrees: float) -> Floats:
    xi = np.zeros(6)
    xi[axis] = np.deg2rad(degrees)
    return se3_exp(xi)


@pytest.mark.parametrize("degrees", [0.0, 0.2])
def test_a_pose_that_is_about_right_is_confirmed_and_made_exact(
    scene: Scene, degrees: float
) -> None:
    tracked = scene.refine(scene.pose @ _turn(1, degrees))
    assert tracked is not None
    assert tracked.inliers > 200
    away = inverse(scene.pose) @ tracked.world_from_cam
    assert np.linalg.norm(away[:3, 3]) < 0.005
    assert np.rad2deg(rotation_angle(away[:3, :3])) < 0.05


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("degrees", [20.0, -20.0])
def test_a_wrong_pose_is_refused(scene: Scene, axis: int, degrees: float) -> None:
    assert scene.refine(scene.pose @ _turn(axis, degrees)) is None


def test_a_pose_from_which_no_landmark_is_in_view_is_refused(scene: Scene) -> None:
    assert scene.refine(scene.pose @ _turn(1, 180.0)) is None


def test_a_pose_that_few_of_the_landmarks_in_view_confirm_is_refused(scene: Scene) -> None:
    dark = scene.with_dark_rows(190)
    assert dark.refine(dark.pose) is None
    tracking = CONFIG.tracking.model_copy(update={"min_share": 0.0})
    tracked = dark.refine(dark.pose, CONFIG.model_copy(update={"tracking": tracking}))
    assert tracked is not None  # so there were enough of them, only their share was small
    assert tracked.inliers >= CONFIG.tracking.min_inliers


@pytest.mark.parametrize(("count", "placed"), [(9, False), (15, True)])
def test_few_landmarks_are_enough_if_they_agree(scene: Scene, count: int, placed: bool) -> None:
    tracked = scene.with_landmarks(count).refine(scene.pose)
    assert (tracked is not None) == placed
    if tracked is not None:
        assert tracked.inliers < CONFIG.tracking.min_inliers
        away = inverse(scene.pose) @ tracked.world_from_cam
        assert np.linalg.norm(away[:3, 3]) < 0.02


def test_few_that_agree_are_not_enough_among_many(scene: Scene) -> None:
    few = scene.with_landmarks(60).with_dark_rows(150)
    tracking = CONFIG.tracking.model_copy(update={"min_inliers": 12})
    tracked = few.refine(few.pose, CONFIG.model_copy(update={"tracking": tracking}))
    assert tracked is not None
    assert 12 <= tracked.inliers < CONFIG.tracking.min_inliers
    assert few.refine(few.pose) is None


def test_half_an_image_confirms_a_pose(scene: Scene) -> None:
    half = scene.with_dark_rows(scene.rig.height // 2)
    tracked = half.refine(half.pose)
    assert tracked is not None
    assert tracked.inliers > 80
