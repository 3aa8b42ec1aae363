from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from room_walk import BASELINE_M, RIG, grey_levels, world_from_cam0

from data_synth.scene.render import camera_rays, render
from data_synth.scene.shutter import moving_shutter, static_shutter
from data_synth.scene.solids import Solid
from data_synth.scene.world import World, build_world
from vo.base.geometry.cameras import normalise, project
from vo.base.geometry.transforms import inverse, make_transform, transform_points
from vo.base.types import Bytes, Camera, Floats, Floats32

PINHOLE = RIG.cam0
DISTORTED = replace(PINHOLE, distortion_model="radtan", distortion=(-0.2, 0.05, 1e-3, -5e-4))
FISHEYE = Camera(480, 480, 180.0, 180.0, 239.5, 239.5, "equidistant", (3.5e-3, 7e-4, -2e-3, 2e-4))
EXPOSURE_S = 0.008
# Up to 40 px of motion; beyond that the patches of Lucas-Kanade change too much to measure.
ROOM_TIMES_S = [(0.0, 0.0667), (1.7, 1.8), (3.1, 3.2), (5.9, 5.95), (7.95, 8.05)]


def _seen(
    world: World, camera: Camera, world_from_cam: Floats, pool: ThreadPoolExecutor
) -> tuple[Bytes, Floats32]:
    view = render(world, camera_rays(camera), static_shutter(world_from_cam), pool)
    return grey_levels(view.image), view.depth


def _tracked(first: Bytes, second: Bytes, pixels: Floats, guess: Floats) -> tuple[Floats, Floats]:
    """Positions by Lucas-Kanade, started from the prediction; and which came back to the start."""
    start = pixels.astype(np.float32).reshape(-1, 1, 2)
    flags = {"winSize": (15, 15), "maxLevel": 1, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        first, second, start, guess.astype(np.float32).reshape(-1, 1, 2), **flags
    )
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(second, first, there, start.copy(), **flags)
    returned = np.linalg.norm((back - start).reshape(-1, 2), axis=1) < 0.3
    return there.reshape(-1, 2).astype(float), (found & found_back).ravel().astype(bool) & returned


def _corners(image: Bytes, depth: Floats32) -> Floats:
    """Corners on one surface: where depth jumps within a patch, it moves in two ways at once."""
    kernel = np.ones((9, 9), np.uint8)
    finite = np.minimum(depth, np.float32(1e6))
    smooth = cv2.dilate(finite, kernel) < 1.05 * cv2.erode(finite, kernel)
    corners = cv2.goodFeaturesToTrack(image, 600, 0.01, 8, mask=smooth.astype(np.uint8))
    return np.asarray(corners.reshape(-1, 2), dtype=np.float64)


def _back_projected(camera: Camera, pixels: Floats, depth: Floats32) -> Floats:
    z = depth[pixels[:, 1].round().astype(int), pixels[:, 0].round().astype(int)]
    return np.column_stack([normalise(camera, pixels), np.ones(len(pixels))]) * z[:, None]


def _blurred(
    world: World, camera: Camera, time_s: float, pool: ThreadPoolExecutor
) -> tuple[Bytes, Floats32]:
    shutter = moving_shutter(world_from_cam0, time_s, camera.height, EXPOSURE_S)
    view = render(world, camera_rays(camera), shutter, pool)
    return grey_levels(view.image), view.depth


@pytest.mark.parametrize(
    "camera", [PINHOLE, DISTORTED, FISHEYE], ids=["pinhole", "radtan", "equidistant"]
)
@pytest.mark.parametrize("times_s", ROOM_TIMES_S)
def test_tracked_pixels_agree_with_depth_and_pose(
    room: World, pool: ThreadPoolExecutor, camera: Camera, times_s: tuple[float, float]
) -> None:
    poses = world_from_cam0(np.array(times_s))
    views = [_seen(room, camera, pose, pool) for pose in poses]
    _check_agreement(camera, poses, views)


@pytest.mark.parametrize("times_s", ROOM_TIMES_S[:3])
def test_tracked_pixels_of_blurred_images_agree_with_mid_exposure(
    room: World, pool: ThreadPoolExecutor, times_s: tuple[float, float]
) -> None:
    views = [_blurred(room, DISTORTED, time_s, pool) for time_s in times_s]
    _check_agreement(DISTORTED, world_from_cam0(np.array(times_s)), views)


def _check_agreement(camera: Camera, poses: Floats, views: list[tuple[Bytes, Floats32]]) -> None:
    (first_pose, second_pose), ((first, depth), (second, second_depth)) = poses, views
    pixels = _corners(first, depth)
    points = transform_points(
        inverse(second_pose) @ first_pose, _back_projected(camera, pixels, depth)
    )
    predicted = project(camera, points)
    rim = (camera.width - 13, camera.height - 13)
    inside = np.all((predicted > 12) & (predicted < rim), axis=1) & (points[:, 2] > 0)
    pixels, predicted, points = pixels[inside], predicted[inside], points[inside]
    u, v = predicted.round().astype(int).T
    visible = np.abs(second_depth[v, u] / points[:, 2] - 1.0) < 0.02
    measured, found = _tracked(first, second, pixels, predicted)
    errors = (measured - predicted)[found & visible]
    assert len(errors) > 100
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.2
    assert np.abs(np.median(errors, axis=0)).max() < 0.03


@pytest.mark.parametrize("time_s", [0.4, 2.9, 6.2])
def test_disparity_is_focal_length_times_baseline_by_depth(
    room: World, pool: ThreadPoolExecutor, time_s: float
) -> None:
    rig = RIG
    assert rig.cam1_from_cam0 is not None
    left_pose = world_from_cam0(np.array([time_s]))[0]
    left, depth = _seen(room, rig.cam0, left_pose, pool)
    right, _ = _seen(room, rig.cam0, left_pose @ inverse(rig.cam1_from_cam0), pool)
    pixels = _corners(left, depth)
    z = _back_projected(rig.cam0, pixels, depth)[:, 2]
    disparity = rig.cam0.fx * BASELINE_M / z
    predicted = pixels - np.column_stack([disparity, np.zeros(len(z))])
    measured, found = _tracked(left, right, pixels, predicted)
    errors = np.abs((pixels - measured)[:, 0] - disparity)[found]
    assert found.sum() > 300
    assert np.median(errors) < 0.1


def test_images_have_many_corners_in_all_parts(room: World, pool: ThreadPoolExecutor) -> None:
    for pose in world_from_cam0(np.arange(0.0, 8.0, 1.0)):
        image, _ = _seen(room, PINHOLE, pose, pool)
        assert len(cv2.ORB_create(3000).detect(image)) > 1000
        corners = cv2.FastFeatureDetector_create(10).detect(image)
        u, v = np.array([k.pt for k in corners]).T
        counts = np.histogram2d(v, u, bins=(5, 8), range=((0, 400), (0, 640)))[0]
        assert counts.min() >= 3


def test_depth_is_exact_on_a_rotated_box(pool: ThreadPoolExecutor) -> None:
    box = Solid((0.0, 0.0, 0.0), (2.0, 1.0, 1.0), texture=0, yaw=np.pi / 2)
    world = build_world([box], [np.full((4, 4), 0.5, np.float32)])
    looking_along_x = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    pose = make_transform(looking_along_x, np.array([-3.0, 0.0, 0.0]))
    view = render(world, camera_rays(Camera(41, 41, 40, 40, 20, 20)), static_shutter(pose), pool)
    assert view.depth[20, 20] == pytest.approx(2.5, abs=1e-6)  # its own y axis points to the camera
    assert view.depth[20, 33] == pytest.approx(2.5, abs=1e-6)
    assert np.isinf(view.depth[0, 20])


def test_distant_fine_stripes_are_rendered_grey_without_moire(pool: ThreadPoolExecutor) -> None:
    stripes = np.tile(np.array([0.0, 1.0], np.float32), (64, 32))
    box = Solid((0.0, 0.0, -0.5), (80.0, 80.0, 1.0), texture=0, density=100.0)
    world = build_world([box], [stripes])
    lights = world.lights._replace(values=np.full_like(world.lights.values, 1.0))
    down_x = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    pose = make_transform(down_x, np.array([0.0, 0.0, 1.5]))
    camera = Camera(320, 200, 176, 176, 159.5, 40)
    view = render(world._replace(lights=lights), camera_rays(camera), static_shutter(pose), pool)
    floor = view.image[60:120]  # less than half a period for each pixel
    assert abs(float(floor.mean()) - 0.5) < 0.01
    assert float(floor.std()) < 0.02
