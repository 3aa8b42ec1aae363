"""Whether patches confirm a first pose."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from vo.base.config import Config, load_config
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.transforms import inverse, rotation_angle, se3_exp
from vo.base.stopwatch import Stopwatch
from vo.base.types import Floats
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.preprocessing import FramePreprocessor, PreprocessedFrame
from vo.engine.frontend.vertical_disparity import VerticalDisparityCorrection
from vo.engine.map_creator import StereoInitializer
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.mapping.tracked_frame import TrackedFrame
from vo.engine.tracking.motion_model import ConstantVelocity
from vo.engine.tracking.tracker import Tracker
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source

CONFIG = load_config("fast")


@dataclass(frozen=True, eq=False)
class Scene:
    """A map from one stereo frame, a later frame, and its true pose in the map."""

    map: LocalMap
    frame: PreprocessedFrame
    pose: Floats

    def refine(self, pose: Floats, config: Config = CONFIG) -> TrackedFrame | None:
        tracker = Tracker(
            self.map,
            make_frontend(config),
            ConstantVelocity(),
            config.tracking,
            config.start,
            Stopwatch(),
        )
        return tracker.refine(self.frame, pose)

    def with_landmarks(self, count: int) -> Scene:
        local_map = deepcopy(self.map)
        tracked = self.refine(self.pose)
        assert tracked is not None
        chosen = tracked.ids[tracked.inlier]
        local_map.keep_landmarks(np.isin(local_map.id, chosen[:: len(chosen) // count][:count]))
        return replace(self, map=local_map)

    def with_dark_rows(self, count: int) -> Scene:
        image = self.frame.image0.copy()
        image[:count] = 0
        images = (image, *self.frame.images[1:])
        return replace(self, frame=replace(self.frame, images=images))


@pytest.fixture(scope="module")
def scene(synthetic_stereo: Path) -> Scene:
    source = open_source(synthetic_stereo)
    rig, frontend = rectified_rig(source.rig), make_frontend(CONFIG)
    extractor, matcher, patches, stereo = frontend
    correction = VerticalDisparityCorrection(rig, matcher, patches, CONFIG.stereo)
    preprocessor = FramePreprocessor(rig, extractor, correction, threads=1)
    first, later = (preprocessor.submit(f).result() for f in source.frames(0, 4, 2))
    local_map = LocalMap(rig, 4, extractor.descriptor_format)
    mapper = LocalMapper(local_map, frontend, CONFIG.mapping, Stopwatch())
    initializer = StereoInitializer(local_map, mapper, CONFIG.start.min_points)
    assert isinstance(initializer.create_map(first, np.eye(4), 0), Keyframe)
    assert len(local_map) > 200
    true = read_tum(synthetic_stereo / "groundtruth.tum").world_from_cam
    return Scene(local_map, later, inverse(true[0]) @ true[2])


def _turn(axis: int, degrees: float) -> Floats:
    xi = np.zeros(6)
    xi[axis] = np.deg2rad(degrees)
    return se3_exp(xi)


@pytest.mark.parametrize("degrees", [0.0, 0.2])
def test_an_approximate_pose_is_confirmed_and_made_exact(scene: Scene, degrees: float) -> None:
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
    tracking = CONFIG.tracking.model_copy(update={"min_inlier_ratio": 0.0})
    tracked = dark.refine(dark.pose, CONFIG.model_copy(update={"tracking": tracking}))
    assert tracked is not None  # so there were enough of them, but their ratio was small
    assert tracked.inliers >= CONFIG.tracking.min_inliers


@pytest.mark.parametrize(("count", "is_tracked"), [(9, False), (15, True)])
def test_few_landmarks_are_enough_if_they_agree(scene: Scene, count: int, is_tracked: bool) -> None:
    tracked = scene.with_landmarks(count).refine(scene.pose)
    assert (tracked is not None) == is_tracked
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
    half = scene.with_dark_rows(scene.map.rig.height // 2)
    tracked = half.refine(half.pose)
    assert tracked is not None
    assert tracked.inliers > 80
