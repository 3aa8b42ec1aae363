from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from vo.config import Config
from vo.frontend.preprocessing import FramePreprocessor, PreprocessedFrame
from vo.geometry.neighbours import far_from
from vo.geometry.rectification import RectifiedRig, rectified_rig
from vo.geometry.transforms import inverse, make_transform, transform_points
from vo.mapping.local_map import Keyframe, Map
from vo.mapping.triangulate_mono import triangulate_between_keyframes
from vo.mapping.triangulate_stereo import look_back, stereo_disparity, triangulate_stereo
from vo.tracking.monocular_initializer import add_keyframe
from vo.types import Bytes, Camera, Floats, Frame, Rig

WIDTH, HEIGHT, FOCAL = 480, 320, 380.0
BASELINE_M = 0.25
CAMERA = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
STEREO = Rig(CAMERA, CAMERA, make_transform(np.eye(3), np.array([-BASELINE_M, 0.0, 0.0])))
CONFIG = Config()
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
    """A map with a working rig, to which frames of the wall are added."""

    def __init__(self, texture: Bytes, rig: Rig) -> None:
        self.texture = texture
        self.rig: RectifiedRig = rectified_rig(rig)
        self.preparation = FramePreprocessor(CONFIG, threads=1)
        self.map = Map(4, HEIGHT, WIDTH)

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
        frame = Frame(number, number, image0, image1)
        return self.preparation.later(frame, self.rig).result()

    def keyframe(self, frame: PreprocessedFrame, world_from_cam: Floats) -> Keyframe:
        free = np.ones(len(frame.keypoints), dtype=bool)
        return add_keyframe(self.map, frame, world_from_cam, 0, free, self.rig)

    def depth_errors(self) -> Floats:
        """How far each landmark is from the wall, as a share of its depth."""
        xyz = self.map.xyz
        return np.asarray((xyz[:, 2] - _wall_depth(xyz[:, 0])) / xyz[:, 2])


def _seed(scene: Scene, keyframe: Keyframe, count: int = 60) -> None:
    """Landmarks on the wall for some features of a keyframe, as an earlier frame would give."""
    rows = np.arange(0, len(keyframe.keypoints), len(keyframe.keypoints) // count)
    rays = scene.rig.back_project(keyframe.undistorted_xy[rows], np.ones(len(rows)))
    keypoints = keyframe.keypoints
    ids = scene.map.add_landmarks(
        _on_wall(rays, keyframe.world_from_cam),
        keypoints.descriptor[rows],
        keypoints.octave[rows],
        keypoints.angle[rows],
        keyframe,
        keypoints.xy[rows].astype(np.float64),
        keyframe,
    )
    xy = keyframe.undistorted_xy[rows]
    nothing, sigma = np.full(len(ids), np.nan), np.full(len(ids), 0.5)
    keyframe.add_observations(ids, xy, keypoints.xy[rows].astype(np.float64), nothing, sigma)
    keyframe.free[rows] = False


# Stereo


def test_stereo_landmarks_lie_on_the_wall(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    frame = scene.frame(SIDEWAYS)
    keyframe = scene.keyframe(frame, SIDEWAYS)
    count = triangulate_stereo(scene.map, keyframe, frame, scene.rig, CONFIG)
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
    found = stereo_disparity(frame, rows, scene.rig, CONFIG)
    rays = scene.rig.back_project(frame.keypoints.xy[rows], np.ones(len(rows)))
    expected = FOCAL * BASELINE_M / _on_wall(rays, np.eye(4))[:, 2]
    assert np.isfinite(found).mean() > 0.4
    error = (found - expected)[np.isfinite(found)]
    # 0.016 with patches that do not follow the wall's slant.
    assert np.median(np.abs(error)) < 0.014
    assert abs(np.median(error)) < 0.005


def test_a_known_disparity_offset_is_taken_off(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    scene.rig = replace(scene.rig, disparity_offset_px=0.6)
    frame = scene.frame(np.eye(4), shift_right_px=0.6)
    keyframe = scene.keyframe(frame, np.eye(4))
    triangulate_stereo(scene.map, keyframe, frame, scene.rig, CONFIG)
    assert abs(np.median(scene.depth_errors())) < 0.002


def test_without_a_right_image_nothing_grows(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    frame = replace(scene.frame(np.eye(4)), image1=None)
    keyframe = scene.keyframe(frame, np.eye(4))
    assert triangulate_stereo(scene.map, keyframe, frame, scene.rig, CONFIG) == 0
    assert len(scene.map) == 0 and keyframe.free.all()


def test_a_right_image_of_something_else_gives_next_to_nothing(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    frame = scene.frame(np.eye(4))
    other = np.ascontiguousarray(frame.image0[::-1])
    frame = replace(frame, image1=other)
    keyframe = scene.keyframe(frame, np.eye(4))
    assert triangulate_stereo(scene.map, keyframe, frame, scene.rig, CONFIG) < 15


def test_new_landmarks_are_found_in_the_keyframe_before(texture: Bytes) -> None:
    scene = Scene(texture, STEREO)
    first = scene.keyframe(scene.frame(np.eye(4)), np.eye(4))
    frame = scene.frame(SIDEWAYS)
    second = scene.keyframe(frame, SIDEWAYS)
    count = triangulate_stereo(scene.map, second, frame, scene.rig, CONFIG)
    look_back(scene.map, second, scene.rig, CONFIG)
    assert len(first.landmark) > 0.5 * count
    rows = scene.map.rows(first.landmark)
    expected = scene.rig.project(scene.map.xyz[rows])
    assert np.median(np.linalg.norm(first.xy - expected, axis=1)) < 0.15
    again = len(first.landmark)
    look_back(scene.map, second, scene.rig, CONFIG)
    assert len(np.unique(first.landmark)) == len(first.landmark) == again


# Mono


def test_mono_landmarks_lie_on_the_wall(texture: Bytes) -> None:
    scene = Scene(texture, Rig(CAMERA))
    first = scene.keyframe(scene.frame(np.eye(4)), np.eye(4))
    _seed(scene, first)
    frame = scene.frame(SIDEWAYS)
    second = scene.keyframe(frame, SIDEWAYS)
    before = len(scene.map)
    count = triangulate_between_keyframes(scene.map, second, frame.image0, scene.rig, CONFIG)
    assert count == len(scene.map) - before > 100
    errors = scene.depth_errors()[before:]
    assert np.median(np.abs(errors)) < 0.01
    assert np.mean(np.abs(errors) > 0.05) < 0.05
    assert len(second.landmark) == count
    rows = scene.map.rows(second.landmark)
    seen = scene.rig.project(transform_points(inverse(SIDEWAYS), scene.map.xyz[rows]))
    assert np.linalg.norm(second.xy - seen, axis=1).max() < 2.0


def test_a_map_grows_from_a_keyframe_far_behind(texture: Bytes) -> None:
    scene = Scene(texture, Rig(CAMERA))
    first = scene.keyframe(scene.frame(np.eye(4)), np.eye(4))
    _seed(scene, first)
    before = len(scene.map)
    ahead = make_transform(np.eye(3), np.array([0.2, 0.0, 0.9]))  # depth is 5 and more
    frame = scene.frame(ahead)
    second = scene.keyframe(frame, ahead)
    assert triangulate_between_keyframes(scene.map, second, frame.image0, scene.rig, CONFIG) > 50
    assert np.mean(np.abs(scene.depth_errors()[before:]) > 0.05) < 0.05


TURNED = make_transform(cv2.Rodrigues(np.array([0.0, 0.3, 0.0]))[0], np.array([0.14, 0.0, 0.0]))
NEARBY = make_transform(np.eye(3), np.array([0.05, 0.0, 0.0]))


def _grown(texture: Bytes, pose: Floats, known: int) -> tuple[int, Floats]:
    """New landmarks of a second keyframe that knows some already, and their depth errors."""
    scene = Scene(texture, Rig(CAMERA))
    _seed(scene, scene.keyframe(scene.frame(np.eye(4)), np.eye(4)))
    frame = scene.frame(pose)
    second = scene.keyframe(frame, pose)
    if known:
        _seed(scene, second, known)
    before = len(scene.map)
    added = triangulate_between_keyframes(scene.map, second, frame.image0, scene.rig, CONFIG)
    return added, scene.depth_errors()[before:]


def test_what_a_turn_shows_with_little_parallax_is_left_alone(texture: Bytes) -> None:
    """1.6 degrees of parallax, while the image moves by 17: its calibration matters as much."""
    assert _grown(texture, TURNED, known=150)[0] == 0


def test_but_in_a_thin_map_it_is_better_than_nothing(texture: Bytes) -> None:
    added, errors = _grown(texture, TURNED, known=0)
    assert 50 < added <= 150
    assert np.median(np.abs(errors)) < 0.02


def test_a_map_about_to_be_lost_takes_what_hardly_shows_its_depth(texture: Bytes) -> None:
    """0.6 degrees of parallax: half of what a landmark needs otherwise."""
    added, errors = _grown(texture, NEARBY, known=0)
    assert 50 < added <= 100
    assert np.median(np.abs(errors)) < 0.05


def test_but_not_one_with_a_hundred_landmarks(texture: Bytes) -> None:
    assert _grown(texture, NEARBY, known=100)[0] == 0


def test_no_feature_makes_two_landmarks(texture: Bytes) -> None:
    scene = Scene(texture, Rig(CAMERA))
    first = scene.keyframe(scene.frame(np.eye(4)), np.eye(4))
    _seed(scene, first)
    frame = scene.frame(SIDEWAYS)
    second = scene.keyframe(frame, SIDEWAYS)
    for _ in range(3):
        assert (
            triangulate_between_keyframes(scene.map, second, frame.image0, scene.rig, CONFIG) <= 600
        )
    for keyframe in (first, second):
        assert len(np.unique(keyframe.landmark)) == len(keyframe.landmark)
        assert len(np.unique(keyframe.xy, axis=0)) == len(keyframe.xy)
    assert np.sum(~first.free) == len(first.landmark)
    assert triangulate_between_keyframes(scene.map, second, frame.image0, scene.rig, CONFIG) < 10


def test_without_translation_no_mono_landmarks_grow(texture: Bytes) -> None:
    scene = Scene(texture, Rig(CAMERA))
    first = scene.keyframe(scene.frame(np.eye(4)), np.eye(4))
    _seed(scene, first)
    turned = make_transform(cv2.Rodrigues(np.array([0.0, 0.05, 0.0]))[0], np.zeros(3))
    frame = scene.frame(turned)
    second = scene.keyframe(frame, turned)
    assert triangulate_between_keyframes(scene.map, second, frame.image0, scene.rig, CONFIG) == 0


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
