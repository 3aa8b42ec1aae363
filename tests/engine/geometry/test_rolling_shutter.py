"""Correction of pixels for a rolling shutter, with projections through one as the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.geometry.transforms import se3_exp
from vo.base.types import Camera, Floats, Rig
from vo.engine.geometry.rolling_shutter import (
    Velocity,
    as_seen,
    at_middle_row,
    disparity_at_middle_row,
    row_times,
)

READOUT_S = 0.03
# Turning as fast as in a hand that looks around, and walking.
VELOCITY = Velocity(np.array([0.8, -1.5, 0.5]), np.array([0.4, -0.3, 1.2]))
IDEAL = Camera(640, 480, 450.0, 455.0, 320.0, 240.0, readout_s=READOUT_S)
LENS = replace(IDEAL, distortion_model="radtan", distortion=(-0.28, 0.07, 2e-4, 2e-5))
PAIR = se3_exp(np.array([0.0141, 4e-4, -0.0023, -0.11, 4e-4, -9e-4]))  # as in EuRoC
RIGS = {
    "ideal": Rig(IDEAL),
    "lens": Rig(LENS),
    "rectified pair": Rig(IDEAL, IDEAL, se3_exp(np.array([0.0, 0.0, 0.0, -0.11, 0.0, 0.0]))),
    "distorted pair": Rig(LENS, LENS, PAIR),
}


def _points(rig: RectifiedRig) -> Floats:
    """Points (N, 3), 1.5 to 30 m ahead, all over the image."""
    rng = np.random.default_rng(0)
    xy = rng.uniform((70, 60), (rig.width - 70, rig.height - 60), (300, 2))
    return rig.back_project(xy, 1.0 / rng.uniform(1 / 30, 1 / 1.5, 300))


def _seen(rig: RectifiedRig, points: Floats, side: int = 0) -> Floats:
    """Pixels (N, 2) in the rows that are read while the camera is where it sees them there."""
    result = np.empty((len(points), 2))
    arm = side * np.array([rig.baseline_m, 0.0, 0.0])
    twist = np.concatenate(VELOCITY)
    for n, point in enumerate(points):
        seconds = 0.0
        for _ in range(20):
            pose = se3_exp(seconds * twist)
            in_cam = pose[:3, :3].T @ (point - pose[:3, 3]) - arm
            result[n] = rig.distort(rig.project(in_cam[None]))[0]
            seconds = float(row_times(rig, result[n : n + 1], side)[0])
    return result


@pytest.mark.parametrize("name", RIGS)
def test_pixels_are_those_of_a_global_shutter(name: str) -> None:
    rig = rectified_rig(RIGS[name])
    points = _points(rig)
    seen, truth = _seen(rig, points), rig.project(points)
    moved = np.linalg.norm(rig.undistort(seen) - truth, axis=1)
    assert np.median(moved) > 3.0
    found = at_middle_row(rig, seen, 1.0 / points[:, 2], VELOCITY)
    assert np.abs(found - truth).max() < 1e-9


@pytest.mark.parametrize("name", RIGS)
def test_points_are_predicted_in_the_rows_that_show_them(name: str) -> None:
    rig = rectified_rig(RIGS[name])
    points = _points(rig)
    found = as_seen(rig, rig.project(points), 1.0 / points[:, 2], VELOCITY)
    assert np.abs(found - _seen(rig, points)).max() < 0.1


# In the second pair 0.07 px are left of an error of up to 0.75 px, since right rows are looked up
# where the point is seen at the time of the left row; as if rows were common to both, 0.40 px.
@pytest.mark.parametrize(("name", "bound"), [("rectified pair", 1e-9), ("distorted pair", 0.1)])
def test_disparities_are_those_of_a_global_shutter(name: str, bound: float) -> None:
    rig = rectified_rig(RIGS[name])
    points = _points(rig)
    seen = _seen(rig, points)
    disparity = seen[:, 0] - _seen(rig, points, side=1)[:, 0]
    truth = rig.fx * rig.baseline_m / points[:, 2]
    found = disparity_at_middle_row(rig, seen, disparity, VELOCITY)
    assert np.abs(disparity - truth).max() > 0.5
    assert np.abs(found - truth).max() < bound


def test_rotation_alone_is_corrected_without_a_depth() -> None:
    rig = rectified_rig(RIGS["ideal"])
    turn = Velocity(VELOCITY.angular, np.zeros(3))
    xy = rig.project(_points(rig))
    seen = as_seen(rig, xy, np.zeros(len(xy)), turn)
    for inverse_depth in (0.0, 0.7):
        np.testing.assert_allclose(at_middle_row(rig, seen, inverse_depth, turn), xy, atol=0.1)


@pytest.mark.parametrize("name", RIGS)
def test_pixels_keep_their_bits_while_the_velocity_is_unknown(name: str) -> None:
    rig = rectified_rig(RIGS[name])
    xy = rig.project(_points(rig))
    np.testing.assert_array_equal(as_seen(rig, xy, np.ones(len(xy)), None), rig.distort(xy))
    np.testing.assert_array_equal(at_middle_row(rig, xy, 1.0, None), rig.undistort(xy))


def test_rows_of_a_pair_are_those_of_the_recorded_images() -> None:
    rig = rectified_rig(RIGS["distorted pair"])
    xy = np.array([[300.0, 40.0], [300.0, 240.0], [300.0, 440.0]])
    left, right = row_times(rig, xy, 0), row_times(rig, xy, 1)
    assert np.all(np.diff(left) > 0.0) and np.abs(left).max() <= READOUT_S / 2
    # The right camera is pitched by 0.8 degrees against the left one, about 6 rows.
    rows = (right - left) / (READOUT_S / 479)
    assert np.all((np.abs(rows) > 3.0) & (np.abs(rows) < 10.0))
