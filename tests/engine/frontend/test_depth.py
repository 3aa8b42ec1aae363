"""Depth as disparity."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.rectification import rectified_rig
from vo.base.types import Camera, Floats32, Rig
from vo.engine.frontend.stereo_matching import disparity_from_depth

CAMERA = Camera(64, 48, 50.0, 51.0, 31.5, 23.5)
RIG = rectified_rig(Rig(CAMERA, has_depth=True))


def plane() -> Floats32:
    """A plane 0.02 x + 0.1 y + 0.3 z = 2."""
    v, u = np.mgrid[:48, :64]
    rays = np.stack([(u - 31.5) / 50.0, (v - 23.5) / 51.0, np.ones((48, 64))])
    inverse_depth = np.tensordot([0.02, 0.1, 0.3], rays, axes=1) / 2.0
    return np.asarray(1.0 / inverse_depth, dtype=np.float32)


def test_is_exact_between_the_pixels_of_a_plane() -> None:
    xy = np.random.default_rng(0).uniform(1.0, 46.0, (200, 2))
    rays = np.column_stack([(xy[:, 0] - 31.5) / 50.0, (xy[:, 1] - 23.5) / 51.0, np.ones(200)])
    expected = RIG.fx * RIG.baseline_m * (rays @ [0.02, 0.1, 0.3]) / 2.0
    np.testing.assert_allclose(disparity_from_depth(plane(), xy, RIG), expected, rtol=1e-5)


def test_knows_nothing_at_holes_edges_and_outside() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    depth[10, 10] = 0.0
    depth[:, 40:] = 3.0
    xy = np.array([[9.5, 9.5], [39.5, 20.0], [-0.5, 5.0], [63.5, 5.0], [5.0, 47.2], [20.0, 20.0]])
    disparity = disparity_from_depth(depth, xy, RIG)
    assert np.isnan(disparity[:5]).all()
    assert disparity[5] == pytest.approx(RIG.fx * RIG.baseline_m / 2.0)


def test_only_a_rig_with_depth_has_the_virtual_baseline() -> None:
    assert RIG.is_metric
    assert not rectified_rig(Rig(CAMERA)).is_metric
    assert not Rig(CAMERA, has_depth=True).is_stereo
    assert Rig(CAMERA, has_depth=True).is_metric
