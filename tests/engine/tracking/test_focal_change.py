"""A scale of the image that landmarks with wrong depths show as well as a zoom does."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.rectification import rectified_rig
from vo.base.types import Camera, Floats, Rig
from vo.engine.mapping.tracked_frame import Observations, TrackedFrame
from vo.engine.tracking.focal_change import FocalChangeDetector

LANDMARKS = 200
RIG = rectified_rig(Rig(Camera(640, 400, 320.0, 320.0, 320.0, 200.0)))


def tracked(xy: Floats) -> TrackedFrame:
    rows, one = np.arange(len(xy)), np.ones(len(xy))
    seen = Observations(rows, xy, xy, one * np.nan, 0.5 * one, one, one, np.zeros((len(xy), 2)))
    return TrackedFrame(np.eye(4), rows, seen, one > 0, len(xy))


def pixels(xyz: Floats, rng: np.random.Generator) -> Floats:
    xy = xyz[:, :2] / xyz[:, 2:] * (RIG.fx, RIG.fy) + (RIG.cx, RIG.cy)
    return np.asarray(xy + rng.normal(0.0, 0.15, xy.shape))


@pytest.mark.parametrize(("zoom", "wrong_depths"), [(1.0, 0.0), (1.0, 0.4), (1.02, 0.0)])
def test_only_a_zoom_explains_the_residuals(zoom: float, wrong_depths: float) -> None:
    rng = np.random.default_rng(0)
    detector = FocalChangeDetector(RIG)
    faults = 0
    for frame in range(60):
        xyz = rng.uniform((-3.0, -2.0, 4.0), (3.0, 2.0, 9.0), (LANDMARKS, 3))
        xy = pixels(xyz, rng)
        if frame >= 30:
            xy = (xy - (RIG.cx, RIG.cy)) * zoom + (RIG.cx, RIG.cy)
            # seen from 1 m behind when they were new, with depths that err, most too large
            ahead = xyz + (0.0, 0.0, 1.0)
            factor = 1.0 + wrong_depths * (rng.random((LANDMARKS, 1)) < 0.5)
            xyz = ahead * factor - (0.0, 0.0, 1.0)
        faults += len(detector.update(xyz, tracked(xy)))
    assert bool(faults) == (zoom > 1.0)
