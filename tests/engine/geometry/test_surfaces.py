from __future__ import annotations

import cv2
import numpy as np
import pytest

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import make_transform
from vo.base.types import Floats
from vo.engine.geometry.surfaces import inverse_depth_slopes, left_from_right, surface_normals

FX, FY, CX, CY = INTRINSICS = Intrinsics(700.0, 710.0, 600.0, 180.0)
HEIGHT_M = 1.65  # of a camera above a road


def _pixels(count: int = 400) -> Floats:
    """Random pixels below the horizon."""
    return np.random.default_rng(0).uniform((0, CY + 20), (1200, CY + 190), (count, 2))


def _road_depth(xy: Floats) -> Floats:
    return np.asarray(FY * HEIGHT_M / (xy[:, 1] - CY))


def test_the_slope_of_a_road_is_the_inverse_of_the_rows_below_the_horizon() -> None:
    xy = _pixels()
    slopes = inverse_depth_slopes(xy, 1.0 / _road_depth(xy), np.arange(len(xy)))
    # Neighbours at very different depths are excluded, more of them above than below; near the
    # horizon the prior matters too.
    reliable = xy[:, 1] > CY + 60
    np.testing.assert_allclose(slopes[reliable, 1] * (xy[reliable, 1] - CY), 1.0, atol=0.03)
    np.testing.assert_allclose(slopes[reliable, 0], 0.0, atol=2e-4)


def test_slopes_are_returned_in_the_order_of_the_rows() -> None:
    xy = _pixels()
    every = inverse_depth_slopes(xy, 1.0 / _road_depth(xy), np.arange(len(xy)))
    of = np.array([17, 3, 399])
    np.testing.assert_array_equal(inverse_depth_slopes(xy, 1.0 / _road_depth(xy), of), every[of])


def test_another_surface_behind_an_edge_is_ignored() -> None:
    xy = _pixels()
    depth = np.where(xy[:, 0] < 600.0, 5.0, 9.0)
    slopes = inverse_depth_slopes(xy, 1.0 / depth, np.arange(len(xy)))
    np.testing.assert_allclose(slopes, 0.0, atol=1e-12)


def test_outliers_in_depth_do_not_tilt_the_surface() -> None:
    rng = np.random.default_rng(1)
    xy = _pixels()
    depth = _road_depth(xy)
    wrong = rng.random(len(xy)) < 0.1
    depth[wrong] *= 1.25
    slopes = inverse_depth_slopes(xy, 1.0 / depth, np.arange(len(xy)))
    reliable = (xy[:, 1] > CY + 60) & ~wrong
    error = np.abs(slopes[reliable, 1] * (xy[reliable, 1] - CY) - 1.0)
    assert np.median(error) < 0.03 and np.mean(error > 0.15) < 0.05


@pytest.mark.parametrize("count", [0, 1])
def test_isolated_points_have_slope_0(count: int) -> None:
    xy = np.array([[100.0, 100.0], [500.0, 100.0]])
    slopes = inverse_depth_slopes(xy, np.array([0.2, 0.21]), np.arange(count))
    np.testing.assert_array_equal(slopes, np.zeros((count, 2)))


def test_normals_are_perpendicular_to_the_plane_in_the_world() -> None:
    pose = make_transform(cv2.Rodrigues(np.array([0.3, -0.5, 0.2]))[0], np.array([1.0, 2.0, 3.0]))
    in_cam = np.array([0.15, 0.05, 0.9]) / 6.0
    xy = np.random.default_rng(2).uniform((300, 50), (900, 310), (300, 2))
    rays = np.column_stack([(xy - (CX, CY)) / (FX, FY), np.ones(len(xy))])
    normals = surface_normals(xy, 1.0 / (rays @ in_cam), np.arange(len(xy)), pose, INTRINSICS)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    expected = pose[:3, :3] @ in_cam
    cosine = normals @ (expected / np.linalg.norm(expected))
    assert cosine.min() > np.cos(np.deg2rad(0.2))


def test_offsets_of_the_right_image_are_warped_to_the_left_on_a_receding_road() -> None:
    """The disparity of a road grows by a third of a pixel per row at a usual baseline."""
    baseline_m, xy = 0.54, _pixels()
    disparity = FX * baseline_m / _road_depth(xy)
    slope = np.column_stack([np.zeros(len(xy)), 1.0 / (xy[:, 1] - CY)])
    back = left_from_right(disparity, slope)
    for step in np.array([[1.0, 0.0], [0.0, 1.0], [-2.0, 3.0]]):
        there = xy + step
        shift = FX * baseline_m / _road_depth(there) - disparity
        in_right = step - np.column_stack([shift, np.zeros(len(xy))])
        taken_back = np.einsum("nij,nj->ni", back, in_right)
        np.testing.assert_allclose(taken_back, np.tile(step, (len(xy), 1)), atol=1e-9)
