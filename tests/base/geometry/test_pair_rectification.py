from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from vo.base.errors import CalibrationError
from vo.base.geometry import cameras
from vo.base.geometry.pair_rectification import RectifiedPair, rectify_pair
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.transforms import inverse, make_transform, so3_exp, transform_points
from vo.base.types import Camera, Floats, Rig

CAMERA = Camera(640, 400, 420.0, 415.0, 318.0, 203.0)
LENSES = {
    "none": (),
    "radtan": (-0.28, 0.08, 0.0004, -0.0003),
    "equidistant": (-0.012, 0.006, -0.004, 0.001),
}
X, Y, Z = np.eye(3)


def _camera(model: str) -> Camera:
    return replace(CAMERA, distortion_model=model, distortion=LENSES[model])  # type: ignore[arg-type]


def _mounted(turn: Floats, position: Floats) -> Floats:
    """cam1_from_cam0 of a camera that is turned by a rotation vector at a position in cam0."""
    return inverse(make_transform(so3_exp(turn), position))


def _random_mounting(seed: int) -> Floats:
    """Any roll, up to 20 degrees of the optical axis, any baseline across the view."""
    random = np.random.default_rng(seed)
    roll = so3_exp(random.uniform(-np.pi, np.pi) * Z)
    tilt = so3_exp(np.array([*random.uniform(-0.25, 0.25, 2), 0.0]))
    along = random.uniform(-np.pi, np.pi)
    position = np.array([np.cos(along), np.sin(along), random.uniform(-0.4, 0.4)])
    return inverse(make_transform(tilt @ roll, random.uniform(0.03, 1.0) * position))


def _pixels(pair: RectifiedPair, side: int, in_cam: Floats) -> Floats:
    rays = in_cam @ pair.rectified_from_cam[side].T
    assert (rays[:, 2] > 0).all()
    return np.asarray((rays / rays[:, 2:]) @ pair.matrix.T)[:, :2]


def _points(cam0: Camera) -> Floats:
    """Points (N, 3) in cam0 all over its image, 2 to 40 m away."""
    random = np.random.default_rng(1)
    xy = random.uniform((60, 60), (580, 340), (200, 2))
    depth = random.uniform(2.0, 40.0, (200, 1))
    return np.asarray(np.column_stack([cameras.normalise(cam0, xy), np.ones(200)]) * depth)


@pytest.mark.parametrize("model", list(LENSES))
@pytest.mark.parametrize("seed", range(12))
def test_rows_agree_and_disparities_are_those_of_the_depth_however_cameras_are_mounted(
    model: str, seed: int
) -> None:
    camera, cam1_from_cam0 = _camera(model), _random_mounting(seed)
    pair = rectify_pair(camera, camera, cam1_from_cam0)
    in_cam0 = _points(camera)
    left = _pixels(pair, 0, in_cam0)
    right = _pixels(pair, 1, transform_points(cam1_from_cam0, in_cam0))
    depth = (in_cam0 @ pair.rectified_from_cam[0].T)[:, 2]
    focal = pair.matrix[0, 0]
    assert np.abs(left[:, 1] - right[:, 1]).max() < 1e-9
    disparity = left[:, 0] - right[:, 0]
    np.testing.assert_allclose(disparity, focal * pair.baseline_m / depth, atol=1e-9)
    assert pair.baseline_m == pytest.approx(np.linalg.norm(cam1_from_cam0[:3, 3]), rel=1e-9)
    assert 0.5 < focal / camera.fx < 2.0 and pair.matrix[1, 1] > 0.0
    for rotation in pair.rectified_from_cam:
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("model", list(LENSES))
@pytest.mark.parametrize("seed", range(4))
def test_maps_lead_to_where_the_cameras_see_a_rectified_pixel(model: str, seed: int) -> None:
    camera, cam1_from_cam0 = _camera(model), _random_mounting(seed)
    pair = rectify_pair(camera, camera, cam1_from_cam0)
    width, height = pair.size
    at = np.stack(np.meshgrid(np.arange(0, width, 40), np.arange(0, height, 40)), axis=-1)
    rays = np.column_stack([at.reshape(-1, 2), np.ones(at[..., 0].size)])
    rays = rays @ np.linalg.inv(pair.matrix).T
    for side in (0, 1):
        exact = cameras.project(camera, rays @ pair.rectified_from_cam[side])
        u, v = cv2.convertMaps(*pair.maps[side], cv2.CV_32FC1)
        found = np.stack([u, v], axis=-1)[::40, ::40].reshape(-1, 2)
        inside = ((exact >= 0) & (exact < (width, height))).all(axis=1)
        assert inside.any()
        np.testing.assert_allclose(found[inside], exact[inside], atol=0.02)


@pytest.mark.parametrize("model", list(LENSES))
@pytest.mark.parametrize(
    ("position", "size", "roll_deg"),
    [(X, (640, 400), 0.0), (Y, (400, 640), 90.0), (-X, (640, 400), 180.0), (-Y, (400, 640), -90.0)],
)
@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 120.0, 180.0, -90.0])
def test_the_image_is_turned_so_that_the_second_camera_is_on_its_right(
    model: str, position: Floats, size: tuple[int, int], roll_deg: float, turn_deg: float
) -> None:
    camera = _camera(model)
    mounted = _mounted(np.deg2rad(turn_deg) * Z, 0.12 * position)
    rig = rectified_rig(Rig(camera, camera, mounted))
    assert (rig.width, rig.height) == size
    assert rig.fx > 0.0 and rig.fy > 0.0 and rig.baseline_m == pytest.approx(0.12)
    expected = so3_exp(np.deg2rad(roll_deg) * Z)
    np.testing.assert_allclose(rig.cam0_from_rectified[:3, :3], expected, atol=1e-9)
    white = rig.rectify(np.full((400, 640), 255, np.uint8), 0)
    assert np.mean(white == 255) > 0.9


@pytest.mark.parametrize("distance", [0.3, -0.3])
def test_cameras_in_front_of_each_other_are_refused(distance: float) -> None:
    where = "in front of" if distance > 0 else "behind"
    mounted = _mounted(np.zeros(3), np.array([0.02, 0.0, distance]))
    with pytest.raises(CalibrationError, match=rf"cam1 is 0\.3 m {where} cam0"):
        rectified_rig(Rig(CAMERA, CAMERA, mounted))


@pytest.mark.parametrize("model", list(LENSES))
@pytest.mark.parametrize("turn", [Y, -Y, X])
@pytest.mark.parametrize("angle_deg", [90, 110, 180])
def test_cameras_that_look_elsewhere_are_refused(
    model: str, turn: Floats, angle_deg: float
) -> None:
    mounted = _mounted(np.deg2rad(angle_deg) * turn, 0.2 * (X + Y))
    with pytest.raises(CalibrationError, match=rf"look {angle_deg}° apart"):
        rectified_rig(Rig(_camera(model), _camera(model), mounted))


def test_cameras_at_the_same_place_are_refused() -> None:
    with pytest.raises(CalibrationError, match="at the same place"):
        rectified_rig(Rig(CAMERA, CAMERA, _mounted(0.1 * Y, np.zeros(3))))


def test_wide_lenses_that_look_45_degrees_apart_still_make_a_pair() -> None:
    lens = Camera(640, 640, 190.0, 190.0, 320.0, 320.0, "equidistant", (0.0, 0.0, 0.0, 0.0))
    rig = rectified_rig(Rig(lens, lens, _mounted(np.deg2rad(45) * Y, 0.2 * X)))
    assert rig.baseline_m == pytest.approx(0.2) and rig.fx == pytest.approx(190.0)
