"""New landmarks of keyframes that look at a slanted wall."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from vo.base.config import Config
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.transforms import inverse, make_transform, transform_points
from vo.base.stopwatch import Stopwatch
from vo.base.types import Bytes, Camera, Floats, Frame, Rig
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.preprocessing import FramePreprocessor, PreprocessedFrame
from vo.engine.frontend.vertical_disparity import VerticalDisparityCorrection
from vo.engine.geometry.neighbours import far_from
from vo.engine.mapping.keyframe import Keyframe, without_disparity
from vo.engine.mapping.keyframe_triangulation import KeyframeTriangulator, StereoTriangulator
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper

WIDTH, HEIGHT, FOCAL = 480, 320, 380.0
BASELINE_M = 0.25
CAMERA = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
STEREO = Rig(CAMERA, CAMERA, make_transform(np.eye(3), np.array([-BASELINE_M, 0.0, 0.0])))
CONFIG = Config()
FRONTEND = make_frontend(CONFIG)
PX_PER_M = 110.0
SIDEWAYS = make_transform(np.eye(3), np.array([0.4, 0.05, 0.1]))


@pytest.fixture(scope="module")
def texture() -> Bytes:
    rng = np.random.default_rng(0)
    image = np.full((1200, 1600), 128, np.uint8)
    for _ in range(6000):
        corners = rng.uniform((0, 0), (1600, 1200)) + rng.uniform(-18, 18, (3, 2))
        cv2.fillConvexPoly(image, corners.astype(np.int32), int(rng.integers(0, 256)), cv2.LINE_AA)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.9), dtype=np.uint8)


def _wall_depth(x: Floats) -> Floats:
    """The scene: a wall, slanted, that fills the view."""
    return 5.0 + 0.25 * x


def _on_wall(rays: Floats, world_from_cam: Floats) -> Floats:
    """Where rays (..., 3) of a camera meet the wall, in the world."""
    directions = rays @ world_from_cam[:3, :3].T
    origin = world_from_cam[:3, 3]
    length = (_wall_depth(origin[0]) - origin[2]) / (directions[..., 2] - 0.25 * directions[..., 0])
    return np.asarray(origin + directions * length[..., None])


def _view(texture: Bytes, world_from_cam: Floats) -> Bytes:
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - CAMERA.cx) / FOCAL, (v - CAMERA.cy) / FOCAL, np.ones(u.shape)], axis=-1)
    points = _on_wall(rays, world_from_cam)
    at = (points[..., :2] * PX_PER_M + (800.0, 600.0)).astype(np.float32)
    return np.asarray(
        cv2.remap(texture, at, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), dtype=np.uint8
    )


class Scene:
    """A map to which frames of the wall are added."""

    def __init__(self, texture: Bytes, rig: Rig) -> None:
        self.texture = texture
        rectified = rectified_rig(rig)
        extractor, matcher, patches, self.stereo = FRONTEND
        correction = VerticalDisparityCorrection(rectified, matcher, patches, CONFIG.stereo)
        self.preprocessor = FramePreprocessor(rectified, extractor, correction, threads=1)
        self.map = LocalMap(rectified, 4, extractor.descriptor_format)
        self.mapper = LocalMapper(self.map, FRONTEND, CONFIG.mapping, Stopwatch())

    def frame(self, world_from_cam: Floats, *, shift_right_px: float = 0.0) -> PreprocessedFrame:
        right = world_from_cam @ make_transform(np.eye(3), np.array([BASELINE_M, 0.0, 0.0]))
        image1 = _view(self.texture, right)
        if shift_right_px:
            move = np.array([[1.0, 0.0, -shift_right_px], [0.0, 1.0, 0.0]])
            image1 = np.asarray(
                cv2.warpAffine(image1, move, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
            )
        number = len(self.map.keyframes)
        image0 = _view(self.texture, world_from_cam)
        frame = Frame(number, number, (image0, image1))
        return self.preprocessor.submit(frame).result()

    def keyframe(self, frame: PreprocessedFrame, world_from_cam: Floats) -> Keyframe:
        free = np.ones(len(frame.keypoints), dtype=bool)
        return self.mapper.add_keyframe_at(frame, world_from_cam, 0, free)

    def triangulate_stereo(self, keyframe: Keyframe, frame: PreprocessedFrame) -> int:
        """Add landmarks of a keyframe's free features with a disparity; their number."""
        before = len(self.map)
        triangulator = StereoTriangulator(self.map, FRONTEND, CONFIG.mapping.new_per_keyframe)
        triangulator.add_landmarks(keyframe, triangulator.measure(frame, keyframe.free))
        return len(self.map) - before

    def triangulate_between(self, keyframe: Keyframe, image: Bytes) -> int:
        """Add landmarks that the newest keyframe shares with earlier ones; their number."""
        before = len(self.map)
        KeyframeTriangulator(self.map, FRONTEND, CONFIG.mapping).add_landmarks(keyframe, image)
        return len(self.map) - before

    def depth_errors(self) -> Floats:
        """Distance of each landmark from the wall along the axis, as a ratio of its depth."""
        xyz = self.map.xyz
        return np.asarray((xyz[:, 2] - _wall_depth(xyz[:, 0])) / xyz[:, 2])


def _seed(scene: Scene, keyframe: Keyframe, count: int = 60) -> None:
    """Landmarks on the wall for some features of a keyframe, as an earlier frame would give."""
    rows = np.arange(0, len(keyframe.keypoints), len(keyframe.keypoints) // count)
    rays = scene.map.rig.back_project(keyframe.undistorted_xy[rows], np.ones(len(rows)))
    keypoints = keyframe.keypoints
    xyz = _on_wall(rays, keyframe.world_from_cam)
    ids = scene.map.add_landmarks(xyz, keyframe, rows, keyframe)
    xy, image_xy = keyframe.undistorted_xy[rows], keypoints.xy[rows].astype(np.float64)
    keyframe.add_observations(without_disparity(ids, xy, image_xy, 0.5))
    keyframe.free[rows] = False


# Stereo


def test_stereo_landmarks_lie_on_the_wall(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    frame = scene.frame(SIDEWAYS)
    keyframe = scene.keyframe(frame, SIDEWAYS)
    count = scene.triangulate_stereo(keyframe, frame)
    assert count == len(scene.map) == len(keyframe.landmark) > 250
    errors = scene.depth_errors()
    assert np.median(np.abs(errors)) < 0.003
    assert np.mean(np.abs(errors) > 0.03) < 0.02
    assert count <= CONFIG.mapping.new_per_keyframe
    assert np.sum(~keyframe.free) == count


def test_disparities_are_those_of_the_wall(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    frame = scene.frame(np.eye(4))
    rows = np.arange(0, len(frame.keypoints), 2)
    found = scene.stereo.disparities(frame, rows, scene.map.rig)
    rays = scene.map.rig.back_project(frame.keypoints.xy[rows], np.ones(len(rows)))
    expected = FOCAL * BASELINE_M / _on_wall(rays, np.eye(4))[:, 2]
    assert np.isfinite(found).mean() > 0.4
    error = (found - expected)[np.isfinite(found)]
    # 0.016 with patches that do not follow the wall's slant.
    assert np.median(np.abs(error)) < 0.014
    assert abs(np.median(error)) < 0.005


def test_known_disparity_offset_is_subtracted(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    scene.map.correct_disparities(0.6, 0.0, is_yaw=False)
    frame = scene.frame(np.eye(4), shift_right_px=0.6)
    keyframe = scene.keyframe(frame, np.eye(4))
    scene.triangulate_stereo(keyframe, frame)
    assert abs(np.median(scene.depth_errors())) < 0.002


def test_without_a_right_image_no_landmark_is_added(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    frame = scene.frame(np.eye(4))
    frame = replace(frame, images=frame.images[:1], features=frame.features[:1])
    keyframe = scene.keyframe(frame, np.eye(4))
    assert scene.triangulate_stereo(keyframe, frame) == 0
    assert len(scene.map) == 0 and keyframe.free.all()


def test_a_right_image_of_something_else_gives_next_to_nothing(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    frame = scene.frame(np.eye(4))
    other = np.ascontiguousarray(frame.image0[::-1])
    frame = replace(frame, images=(frame.image0, other))
    keyframe = scene.keyframe(frame, np.eye(4))
    assert scene.triangulate_stereo(keyframe, frame) < 15


def test_new_landmarks_are_found_in_the_keyframe_before(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    first = scene.keyframe(scene.frame(np.eye(4)), np.eye(4))
    frame = scene.frame(SIDEWAYS)
    second = scene.keyframe(frame, SIDEWAYS)
    scene.mapper.extend(second, frame)
    count = len(scene.map)
    assert len(first.landmark) > 0.5 * count
    rows = scene.map.rows(first.landmark)
    expected = scene.map.rig.project(scene.map.xyz[rows])
    assert np.median(np.linalg.norm(first.xy - expected, axis=1)) < 0.15
    again = len(first.landmark)
    second.free[:] = False  # so that no landmark is new
    scene.mapper.extend(second, frame)
    assert len(scene.map) == count
    assert len(np.unique(first.landmark)) == len(first.landmark) == again


# Mono


def test_mono_landmarks_lie_on_the_wall(texture: Bytes) -> None:
    scene = Scene(texture, Rig(CAMERA))
    first = scene.keyframe(scene.frame(np.eye(4)), np.eye(4))
    _seed(scene, first)
    frame = scene.frame(SIDEWAYS)
    second = scene.keyframe(frame, SIDEWAYS)
    before = len(scene.map)
    count = scene.triangulate_between(second, frame.image0)
    assert count == len(scene.map) - before > 100
    errors = scene.depth_errors()[before:]
    assert np.median(np.abs(errors)) < 0.01
    assert np.mean(np.abs(errors) > 0.05) < 0.05
    assert len(second.landmark) == count
    rows = scene.map.rows(second.landmark)
    seen = scene.map.rig.project(transform_points(inverse(SIDEWAYS), scene.map.xyz[rows]))
    assert np.linalg.norm(second.xy - seen, axis=1).max() < 2.0


def test_landmarks_are_added_from_a_keyframe_far_behind(texture: Bytes) -> None:
    scene = Scene(texture, Rig(CAMERA))
    first = scene.keyframe(scene.frame(np.eye(4)), np.eye(4))
    _seed(scene, first)
    before = len(scene.map)
    ahead = make_transform(np.eye(3), np.array([0.2, 0.0, 0.9]))  # depth is 5 and more
    frame = scene.frame(ahead)
    second = scene.keyframe(frame, ahead)
    assert scene.triangulate_between(second, frame.image0) > 50
    assert np.mean(np.abs(scene.depth_errors()[before:]) > 0.05) < 0.05


TURNED = make_transform(cv2.Rodrigues(np.array([0.0, 0.3, 0.0]))[0], np.array([0.14, 0.0, 0.0]))
NEARBY = make_transform(np.eye(3), np.array([0.05, 0.0, 0.0]))


def _added(texture: Bytes, pose: Floats, known: int) -> tuple[int, Floats]:
    """Number of new landmarks of a second keyframe that observes `known`, and depth errors."""
    scene = Scene(texture, Rig(CAMERA))
    _seed(scene, scene.keyframe(scene.frame(np.eye(4)), np.eye(4)))
    frame = scene.frame(pose)
    second = scene.keyframe(frame, pose)
    if known:
        _seed(scene, second, known)
    before = len(scene.map)
    added = scene.triangulate_between(second, frame.image0)
    return added, scene.depth_errors()[before:]


def test_points_with_little_parallax_in_a_turn_are_not_added(texture: Bytes) -> None:
    """1.6 degrees of parallax while the image moves by 17: calibration errors are as large."""
    assert _added(texture, TURNED, known=150)[0] == 0


def test_points_with_little_parallax_in_a_turn_are_added_to_few_landmarks(texture: Bytes) -> None:
    added, errors = _added(texture, TURNED, known=0)
    assert 50 < added <= 150
    assert np.median(np.abs(errors)) < 0.02


def test_points_of_uncertain_depth_are_added_to_very_few_landmarks(texture: Bytes) -> None:
    """0.6 degrees of parallax: half of what a landmark needs otherwise."""
    added, errors = _added(texture, NEARBY, known=0)
    assert 50 < added <= 100
    assert np.median(np.abs(errors)) < 0.05


def test_points_of_uncertain_depth_are_not_added_to_a_hundred_landmarks(texture: Bytes) -> None:
    assert _added(texture, NEARBY, known=100)[0] == 0


def test_no_feature_makes_two_landmarks(texture: Bytes) -> None:
    scene = Scene(texture, Rig(CAMERA))
    first = scene.keyframe(scene.frame(np.eye(4)), np.eye(4))
    _seed(scene, first)
    frame = scene.frame(SIDEWAYS)
    second = scene.keyframe(frame, SIDEWAYS)
    for _ in range(3):
        assert scene.triangulate_between(second, frame.image0) <= 600
    for keyframe in (first, second):
        assert len(np.unique(keyframe.landmark)) == len(keyframe.landmark)
        assert len(np.unique(keyframe.xy, axis=0)) == len(keyframe.xy)
    assert np.sum(~first.free) == len(first.landmark)
    assert scene.triangulate_between(second, frame.image0) < 10


def test_without_translation_no_mono_landmark_is_added(texture: Bytes) -> None:
    scene = Scene(texture, Rig(CAMERA))
    first = scene.keyframe(scene.frame(np.eye(4)), np.eye(4))
    _seed(scene, first)
    turned = make_transform(cv2.Rodrigues(np.array([0.0, 0.05, 0.0]))[0], np.zeros(3))
    frame = scene.frame(turned)
    second = scene.keyframe(frame, turned)
    assert scene.triangulate_between(second, frame.image0) == 0


# Spread


def test_pixels_near_taken_ones_are_not_far_from_them() -> None:
    rng = np.random.default_rng(0)
    xy, taken = rng.uniform((0, 0), (300, 200), (2, 400, 2))
    distance = np.linalg.norm(xy[:, None] - taken[None], axis=2).min(axis=1)
    far = far_from(xy, taken)
    assert not far[distance < 6.0].any()
    assert far[distance > 17.0].all()


def test_everything_is_far_from_nothing() -> None:
    xy = np.random.default_rng(0).uniform(0, 100, (5, 2))
    assert far_from(xy, np.empty((0, 2))).all()
    assert far_from(np.empty((0, 2)), xy).shape == (0,)
