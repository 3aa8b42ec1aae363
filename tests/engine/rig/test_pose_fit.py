"""The pose of a rig from landmarks in views that look to different sides, at different times."""

from __future__ import annotations

import numpy as np
import pytest
from rig_walks import at

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import inverse, se3_exp, se3_log, transform_points
from vo.base.types import Floats
from vo.engine.rig.pose_fit import RigObservations, RigTies, fit_rig
from vo.engine.rig.velocity import VelocityPrior

INTRINSICS = Intrinsics(160.0, 160.0, 159.5, 119.5)
VIEWS = np.stack([at(0), at(90, 0.15, -0.15), at(180, 0.0, -0.3)])
POSE = se3_exp(np.array([0.1, -0.2, 0.05, 0.3, -0.1, 0.2]))  # world_from_body
AT_REST = RigTies(VIEWS, np.zeros(3), np.zeros(6))
TWIST = np.array([0.1, 0.8, -0.1, 1.5, 0.2, -0.3])


def observed(delay_s: Floats, outliers: int = 0) -> RigObservations:
    """Forty points in each view, as a moving rig sees them."""
    random = np.random.default_rng(0)
    points, pixels, views = [], [], []
    for view, tied in enumerate(VIEWS):
        in_view = random.uniform((-1.5, -1, 2), (1.5, 1, 6), (40, 3))
        in_view[:, :2] *= in_view[:, 2:] / 4.0
        pose = POSE @ se3_exp(delay_s[view] * TWIST) @ tied
        points.append(transform_points(pose, in_view))
        pixels.append(in_view[:, :2] / in_view[:, 2:] * 160.0 + (159.5, 119.5))
        views.append(np.full(40, view))
    xy = np.concatenate(pixels)
    xy[random.choice(len(xy), outliers, replace=False)] += 20.0
    return RigObservations(np.concatenate(points), xy, np.ones(len(xy)), np.concatenate(views))


@pytest.mark.parametrize("outliers", [0, 30])
def test_finds_the_pose_and_the_outliers(outliers: int) -> None:
    start = inverse(POSE @ se3_exp(np.array([0.02, 0.03, -0.02, 0.05, -0.04, 0.03])))
    fit = fit_rig(start, observed(np.zeros(3), outliers), AT_REST, INTRINSICS, 3.5)
    assert np.abs(se3_log(fit.body_from_world @ POSE)).max() < 1e-5
    assert np.count_nonzero(~fit.inlier) == outliers


def test_finds_the_velocity_of_views_with_different_times() -> None:
    delay_s = np.array([0.0, 0.02, 0.04])
    before = POSE @ se3_exp(-0.1 * TWIST)
    prior = VelocityPrior(before, 0.1, -0.2 * TWIST, np.full(6, 0.5))
    ties = RigTies(VIEWS, delay_s, 0.8 * TWIST, prior)
    fit = fit_rig(inverse(POSE), observed(delay_s), ties, INTRINSICS, 3.5)
    # The velocity stays near that given, which pulls the pose a little.
    assert np.abs(se3_log(fit.body_from_world @ POSE)).max() < 0.002
    assert np.abs(fit.ties.twist - TWIST).max() < 0.08
    still = fit_rig(inverse(POSE), observed(delay_s), AT_REST, INTRINSICS, 3.5)
    assert np.abs(se3_log(still.body_from_world @ POSE)).max() > 0.01  # as if all had one time
