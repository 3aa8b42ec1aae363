"""Motion since the last frame from the patches of its landmarks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from vo.base.config import load_config
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.transforms import inverse, rotation_angle, se3_exp, transform_points
from vo.base.stopwatch import Stopwatch
from vo.base.types import Bytes, Floats
from vo.engine.frontend.camera_alignment import half_size_pyramid
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.preprocessing import FramePreprocessor, PreprocessedFrame
from vo.engine.frontend.vertical_disparity import VerticalDisparityCorrection
from vo.engine.map_creator import StereoInitializer
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.mapping.tracked_frame import LastFrame, as_tracked_frame, last_frame
from vo.engine.tracking.sparse_image_alignment import sparse_image_alignment
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source

CONFIG = load_config("fast")


@dataclass(frozen=True, eq=False)
class Scene:
    """A map from one stereo frame, its landmarks, a later frame, and its true pose."""

    map: LocalMap
    last: LastFrame
    frame: PreprocessedFrame
    pose: Floats

    def align(self, predicted: Floats, frame: PreprocessedFrame | None = None) -> Floats | None:
        frame = frame or self.frame
        return sparse_image_alignment(self.map, self.last, np.eye(4), frame, predicted)

    def with_image(self, image: Bytes) -> PreprocessedFrame:
        images = (image, *self.frame.images[1:])
        return replace(self.frame, images=images, pyramid=half_size_pyramid(image))


@pytest.fixture(scope="module")
def scene(synthetic_stereo: Path) -> Scene:
    source = open_source(synthetic_stereo)
    rig, frontend = rectified_rig(source.rig), make_frontend(CONFIG)
    extractor, matcher, patches, stereo = frontend
    correction = VerticalDisparityCorrection(rig, matcher, patches, CONFIG.stereo)
    preprocessor = FramePreprocessor(rig, extractor, correction, threads=1)
    preprocessor.is_eager = False
    first, later = (preprocessor.submit(f).result() for f in source.frames(0, 4, 2))
    local_map = LocalMap(rig, 4, extractor.descriptor_format)
    mapper = LocalMapper(local_map, frontend, CONFIG.mapping, Stopwatch())
    initializer = StereoInitializer(local_map, mapper, CONFIG.start.min_points)
    keyframe = initializer.create_map(first, np.eye(4), 0)
    assert isinstance(keyframe, Keyframe)
    last = last_frame(first, as_tracked_frame(local_map, keyframe))
    true = read_tum(synthetic_stereo / "groundtruth.tum").world_from_cam
    return Scene(local_map, last, later, inverse(true[0]) @ true[2])


@pytest.mark.parametrize("degrees", [0.0, 1.5, -1.5])
def test_pose_is_found_from_a_prediction_many_pixels_off(scene: Scene, degrees: float) -> None:
    turn = se3_exp(np.array([0.0, np.deg2rad(degrees), 0.0, 0.0, 0.0, 0.0]))
    found = scene.align(scene.pose @ turn)
    assert found is not None
    away = inverse(scene.pose) @ found
    assert np.linalg.norm(away[:3, 3]) < 0.01
    assert np.rad2deg(rotation_angle(away[:3, :3])) < 0.06


def test_motion_is_the_same_after_optimisation_has_moved_everything(scene: Scene) -> None:
    motion = se3_exp(np.array([0.02, -0.3, 0.01, 0.4, 0.1, -0.2]))
    before = scene.map.xyz.copy()
    scene.map.xyz = transform_points(motion, before)
    predicted = motion @ scene.pose
    moved = sparse_image_alignment(scene.map, scene.last, motion, scene.frame, predicted)
    scene.map.xyz = before
    found = scene.align(scene.pose)
    assert found is not None and moved is not None
    np.testing.assert_allclose(moved, found, atol=1e-5)


def test_no_features_are_extracted(scene: Scene) -> None:
    scene.align(scene.pose)
    assert not any(features is not None and features.is_used for features in scene.frame.features)
    assert len(scene.frame.used_keypoints_xy) == 0


def test_another_scene_or_none_gives_no_pose(scene: Scene) -> None:
    image = scene.frame.image0
    assert scene.align(scene.pose, scene.with_image(np.zeros_like(image))) is None
    upside_down = np.ascontiguousarray(image[::-1, ::-1])
    assert scene.align(scene.pose, scene.with_image(upside_down)) is None


def test_too_few_landmarks_give_no_pose(scene: Scene) -> None:
    few = LastFrame(scene.last.frame, *(part[:15] for part in scene.last[1:]))
    assert replace(scene, last=few).align(scene.pose) is None
