"""Residuals of landmarks that show a zoom, or a torn image, and those that only resemble them."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.faults import FaultKind
from vo.base.geometry.rectification import rectified_rig
from vo.base.types import Camera, Floats, Rig
from vo.engine.mapping.tracked_frame import Observations, TrackedFrame
from vo.engine.tracking.focal_change import FocalChangeDetector
from vo.engine.tracking.pose_residuals import pose_residuals
from vo.engine.tracking.torn_images import TornImageDetector

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
    detector = FocalChangeDetector()
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
        if frame % 3 == 2:  # as the tracker does
            detector.update(pose_residuals(RIG, xyz, tracked(xy)))
        faults += len(detector.faults)
    assert bool(faults) == (zoom > 1.0)


@pytest.mark.parametrize(
    ("shift_px", "shear_px", "torn_frames"),
    [(4.0, 0.0, 12), (4.0, 0.0, 3), (0.0, 6.0, 12), (0.0, 0.0, 12)],
    ids=["torn", "hardly ever", "rolling shutter", "noise"],
)
def test_only_a_jump_at_a_row_is_a_torn_image(
    shift_px: float, shear_px: float, torn_frames: int
) -> None:
    rng = np.random.default_rng(0)
    detector = TornImageDetector(RIG.height)
    for frame in range(60):
        xyz = rng.uniform((-3.0, -2.0, 4.0), (3.0, 2.0, 9.0), (LANDMARKS, 3))
        xy = pixels(xyz, rng) + rng.normal(0.0, 0.3, (LANDMARKS, 2))
        if 20 <= frame < 20 + torn_frames:
            xy[:, 0] += shift_px * (xy[:, 1] > rng.uniform(100.0, 300.0))
            xy[:, 0] += shear_px * xy[:, 1] / RIG.height
        detector.update(pose_residuals(RIG, xyz, tracked(xy)))
        if frame == 40:
            found = detector.faults
    is_torn = shift_px > 0 and torn_frames > 5
    assert [fault.kind for fault in found] == [FaultKind.TORN_IMAGES] * is_torn
