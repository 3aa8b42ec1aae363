"""Pieces of a path on both sides of a gap without images, joined by wheel odometry."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from wheels import BASE_IN_CAM, arc_path

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, Ints, KeyframePose, Trajectory
from vo.engine.geometry import sim3
from vo.engine.trajectory.store import TrajectoryStore
from vo.runs.scaling.moved_path import move_path
from vo.runs.scaling.wheel_joins import join_pieces
from vo.runs.scaling.wheel_odometry import WheelOdometry
from vo.runs.scaling.wheel_source import WheelSource

GAP = (12.0, 16.0)  # of 30 s, 8 m
ARM_M = (0.8, 0.3)


class Course(NamedTuple):
    """The true path, the one of images, and what wheels say of it."""

    truth: Trajectory
    rows: Ints  # of frames with a pose
    store: TrajectoryStore
    wheel: WheelSource


def wheels_of(truth: Trajectory, seed: int) -> WheelOdometry:
    """At 20 Hz: noise of 2 % in each way, and of 4 mrad in each turn, which are 1 % too large."""
    rng = np.random.default_rng(seed)
    base = truth.world_from_cam[:, :3, :3] @ BASE_IN_CAM
    heading = np.unwrap(np.arctan2(base[:, 1, 0], base[:, 0, 0]))
    base_xy = (truth.positions - base @ np.array([*ARM_M, 0.0]))[:, :2]
    way = np.r_[0.0, np.linalg.norm(np.diff(base_xy, axis=0), axis=1)]
    way *= 1.0 + rng.normal(0.0, 0.02, len(way))
    turn = 1.01 * np.diff(heading, prepend=heading[0]) + rng.normal(0.0, 0.004, len(way))
    measured = np.cumsum(turn)
    middle = measured - 0.5 * turn
    xy = np.cumsum(way[:, None] * np.column_stack([np.cos(middle), np.sin(middle)]), axis=0)
    parts = np.zeros(len(way), np.int64)
    return WheelOdometry("wheels", truth.stamps_ns, np.cumsum(way), measured, xy, parts)


def course(seed: int, unit_m: float | None = None) -> Course:
    """A path in two worlds; with a unit the path of one camera, with another one in each."""
    truth = arc_path(30.0, arm_m=ARM_M)
    times = 1e-9 * (truth.stamps_ns - truth.stamps_ns[0])
    rows = np.flatnonzero((times < GAP[0]) | (times > GAP[1]))
    store = TrajectoryStore(is_metric=unit_m is None)
    steps = np.arange(1.0, 7.0)[None, :] ** 2 * 1e-12
    for number, row in enumerate(rows.tolist()):
        segment = int(times[row] > GAP[1])
        first = int(rows[0]) if segment == 0 else int(rows[np.searchsorted(times[rows], GAP[1])])
        pose = inverse(truth.world_from_cam[first]) @ truth.world_from_cam[row]
        pose[:3, 3] /= 1.0 if unit_m is None else unit_m * (1.0 + segment)
        stamp_ns, covariance = int(truth.stamps_ns[row]), np.diag(steps[0] * (1.0 + row - first))
        store.store(number, KeyframePose(row, stamp_ns, segment, pose, covariance))
        store.add(row, stamp_ns, segment, number, pose)
    wheel = WheelSource(wheels_of(truth, seed), is_metric=unit_m is None)
    findings = wheel.measure(store.path())
    store.apply_scales(findings.by_segment())
    return Course(truth, rows, store, wheel)


def error_of_join(made: Course, first: int) -> tuple[Floats, Floats]:
    """Tangent (6,) of the later piece relative to the earlier one, and its covariance (6, 6)."""
    before, after = made.store.keyframes_by_id([first - 1, first])
    found = inverse(before.world_from_cam0) @ after.world_from_cam0
    true_poses = made.truth.world_from_cam[made.rows[[first - 1, first]]]
    off = sim3.local((inverse(found) @ inverse(true_poses[0]) @ true_poses[1])[None])[0, :6]
    assert after.covariance is not None
    return off, after.covariance


@pytest.mark.parametrize("unit_m", [None, 3.0])
def test_the_later_piece_is_where_its_covariance_says(unit_m: float | None) -> None:
    squared, off_m = [], []
    for seed in range(16):
        made = course(seed, unit_m)
        assert set(made.wheel.fits) == {0, 1}
        (join,) = join_pieces(made.store, made.wheel, ())
        assert set(made.store.path().world.tolist()) == {0}
        off, covariance = error_of_join(made, join.keyframe)
        planar = np.ix_([1, 3, 5], [1, 3, 5])  # the others are exact here, and their sigmas small
        squared.append(off[[1, 3, 5]] @ np.linalg.solve(covariance[planar], off[[1, 3, 5]]))
        off_m.append(np.linalg.norm(off[3:]))
    assert np.median(off_m) < 0.4 and max(off_m) < 0.8  # of 8 m, with a turn of 83°
    assert 1.2 < np.mean(squared) < 6.0  # of 3 numbers


def test_the_piece_of_one_camera_keeps_its_own_scale() -> None:
    made = course(0, 3.0)
    before = made.store.path().trajectory.positions
    join_pieces(made.store, made.wheel, ())
    after = made.store.path().trajectory.positions
    lengths = [np.linalg.norm(np.diff(each, axis=0), axis=1) for each in (before, after)]
    gap = int(np.searchsorted(made.rows, made.rows[np.argmax(np.diff(made.rows))]))
    inside = np.arange(len(lengths[0])) != gap
    np.testing.assert_allclose(lengths[0][inside], lengths[1][inside], rtol=1e-9)
    scales = made.store.scales_of_segments()
    assert scales[1].value == pytest.approx(2.0 * scales[0].value, rel=0.02)


@pytest.mark.parametrize("reason", ["no heading", "gap in the samples", "placed by positions"])
def test_pieces_stay_apart(reason: str) -> None:
    made = course(0)
    wheel, kept = made.wheel.wheel, [1] if reason == "placed by positions" else []
    if reason == "no heading":
        made.wheel.wheel = replace(wheel, heading_rad=None, xy_m=None)
    if reason == "gap in the samples":
        is_late = wheel.stamps_ns > wheel.stamps_ns[0] + 14 * 10**9
        made.wheel.wheel = replace(wheel, parts=is_late.astype(np.int64))
    before = made.store.path().trajectory.world_from_cam
    assert join_pieces(made.store, made.wheel, kept) == []
    np.testing.assert_array_equal(made.store.path().trajectory.world_from_cam, before)


def test_joined_pieces_are_one_world_and_the_user_is_told() -> None:
    made = course(1)
    moved = move_path(made.store, None, made.wheel, [])
    assert set(made.store.path().world.tolist()) == {0}
    assert len(moved.notes) == 1 and "by the wheels alone" in moved.notes[0]
    assert "4.0 s" in moved.notes[0] or "4.1 s" in moved.notes[0]
