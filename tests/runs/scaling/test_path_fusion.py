"""Drives of ten minutes with realistic drift, moved by positions with drop-outs and outliers."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats
from vo.engine.geometry import sim3
from vo.runs.scaling.fit import fit_positions
from vo.runs.scaling.path_factors import Fixes, Given, LoopFactors, WayFactors
from vo.runs.scaling.path_fusion import FusedPath, fuse_path

SECONDS, SPEED = 600.0, 8.33
DROP_OUT = (300.0, 360.0)  # 60 s and 500 m
ARM_M = np.array([0.5, -0.8, -0.35])
NO_LOOPS = LoopFactors(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 7, 7)))


class Drift(NamedTuple):
    """Errors of odometry for each step of a second, random or the same in all of them."""

    step_rad: float = 5e-4
    step_ratio: float = 2e-3
    rad_per_m: float = 1e-5
    ratio: float = 2e-3
    log_scale: float = 0.0


USUAL = Drift()
NEARLY_NONE = Drift(3e-5, 3e-4, 1e-6, 2e-4)


class Drive(NamedTuple):
    """Keyframes each second, as they are and by odometry, and positions."""

    true_poses: Floats
    poses: Floats
    fixes: Fixes
    is_outlier: Floats


def make_drive(
    seed: int,
    drift: Drift = USUAL,
    white_m: float = 2.0,
    slow_m: float = 0.0,
    outliers: float = 0.03,
) -> Drive:
    """Turns and stops; the path is aligned with the positions as `fit_positions` does it."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, SECONDS)
    speed = SPEED * (1.0 + 0.4 * np.sin(0.14 * times + rng.uniform(0.0, 6.0)))
    turning = np.where(rng.random(len(times)) < 0.1, rng.normal(0.0, 0.4, len(times)), 0.0)
    turning = np.convolve(turning, np.ones(4), mode="same")
    heading = np.cumsum(turning)
    forward = np.column_stack([np.cos(heading), np.sin(heading), 0.03 * np.sin(0.1 * times)])
    forward /= np.linalg.norm(forward, axis=1)[:, None]
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1)[:, None]
    true_poses = np.tile(np.eye(4), (len(times), 1, 1))
    true_poses[:, :3, :3] = np.stack([right, np.cross(forward, right), forward], axis=2)
    ahead = forward + np.vstack([forward[:1], forward[:-1]])  # on arcs
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    true_poses[:, :3, 3] = np.cumsum(speed[:, None] * ahead, axis=0)
    given = _drifted(true_poses, drift, rng)
    slow = np.zeros((len(times), 3))
    for row in range(1, len(times)):
        slow[row] = 0.967 * slow[row - 1] + slow_m * 0.25 * rng.normal(size=3)  # over 30 s
    noise = slow + rng.normal(0.0, max(white_m, 1e-9), (len(times), 3))
    is_outlier = rng.random(len(times)) < outliers
    noise[is_outlier] += rng.normal(0.0, 30.0, (int(is_outlier.sum()), 3))
    xyz = true_poses[:, :3, 3] + true_poses[:, :3, :3] @ ARM_M + noise
    rows = np.flatnonzero((times < DROP_OUT[0]) | (times > DROP_OUT[1]))
    poses, scale = sim3.rigid_part(given), sim3.scale_of(given)
    arms = scale[rows, None] * (poses[rows, :3, :3] @ ARM_M)
    is_mono = drift.log_scale > 0.0
    fit = fit_positions(times[rows], poses[rows, :3, 3] + arms, xyz[rows], with_scale=is_mono)
    assert fit is not None
    poses[:, :3, 3] *= fit.scale
    aligned = np.eye(4)
    aligned[:3, :3], aligned[:3, 3] = fit.rotation, fit.translation
    in_cam = fit.scale * scale[rows, None] * ARM_M
    velocity = speed[rows, None] * forward[rows]
    ones = np.ones(len(rows))
    fixes = Fixes(times[rows], rows, in_cam, velocity, xyz[rows], ones)
    return Drive(true_poses, aligned @ poses, fixes, is_outlier[rows])


def _drifted(true_poses: Floats, drift: Drift, rng: np.random.Generator) -> Floats:
    motions = inverse(true_poses[:-1]) @ true_poses[1:]
    way = np.linalg.norm(motions[:, :3, 3], axis=1)[:, None]
    error = np.zeros((len(motions), 7))
    turn = rng.normal(0.0, drift.rad_per_m, 3)
    error[:, :3] = rng.normal(0.0, drift.step_rad, (len(motions), 3)) + turn * way
    error[:, 3:6] = rng.normal(0.0, drift.step_ratio, (len(motions), 3)) * way
    error[:, 5] += rng.normal(0.0, drift.ratio) * way[:, 0]
    error[:, 6] = rng.normal(0.0, max(drift.log_scale, 1e-300), len(motions))
    poses = [np.eye(4)]
    for motion, step in zip(motions, sim3.retract(error), strict=True):
        poses.append(poses[-1] @ motion @ step)
    return np.stack(poses)


def fused(drive: Drive, loops: LoopFactors = NO_LOOPS, *, is_metric: bool = True) -> FusedPath:
    found = fuse_path(drive.poses, drive.fixes, Given(loops, is_metric))
    assert found is not None
    return found


def errors_m(drive: Drive, poses: Floats) -> Floats:
    return np.asarray(np.linalg.norm((poses - drive.true_poses)[:, :3, 3], axis=1))


def nees(drive: Drive, found: FusedPath) -> float:
    """Mean squared error of poses in their covariance, by six."""
    off = sim3.local(inverse(sim3.rigid_part(found.poses)) @ drive.true_poses)[:, :6]
    solved = np.linalg.solve(found.in_frame[:, :6, :6], off[:, :, None])[:, :, 0]
    return float((off * solved).sum(axis=1).mean() / 6.0)


def test_the_end_of_a_drop_out_of_500_m_is_known() -> None:
    ends, ratios = [], []
    for seed in range(4):
        drive = make_drive(seed)
        found = fused(drive)
        assert found.is_moved
        before, after = errors_m(drive, drive.poses), errors_m(drive, found.poses)
        assert np.sqrt((after**2).mean()) < 0.4 * np.sqrt((before**2).mean())
        ends.append(after[int(DROP_OUT[1])])
        ratios.append(nees(drive, found))
        refused = ~found.used
        assert refused[drive.is_outlier > 0].mean() > 0.8
        assert refused[drive.is_outlier == 0].mean() < 0.03
        assert 1.4 < float(np.hypot(found.noise.white_m, found.noise.slow_m)) < 3.0
    assert np.mean(ends) < 1.5
    assert 0.3 < np.mean(ratios) < 2.0


def test_the_scale_of_one_camera_drifts_no_more() -> None:
    drive = make_drive(1, Drift(log_scale=2e-3))
    found = fused(drive, is_metric=False)
    assert found.is_moved
    before, after = errors_m(drive, drive.poses), errors_m(drive, found.poses)
    assert np.sqrt((after**2).mean()) < 0.2 * np.sqrt((before**2).mean())
    assert 0.2 < nees(drive, found) < 3.0
    assert np.ptp(np.log(sim3.scale_of(found.poses))) > 0.01


@pytest.mark.parametrize("slow_m", [0.0, 1.4])
def test_positions_that_are_worse_than_odometry_move_nothing(slow_m: float) -> None:
    for seed in range(2):
        drive = make_drive(seed, NEARLY_NONE, 2.0, slow_m)
        found = fused(drive)
        if found.is_moved:
            before, after = errors_m(drive, drive.poses), errors_m(drive, found.poses)
            assert np.sqrt((after**2).mean()) < np.sqrt((before**2).mean())
        else:
            np.testing.assert_allclose(found.poses, drive.poses, atol=1e-9)


def test_a_jump_of_positions_is_none_of_the_path() -> None:
    drive = make_drive(2, white_m=0.5)
    drive.fixes.xyz[400:] += (12.0, -9.0, 4.0)
    found = fused(drive)
    assert found.jumps == 1
    after = errors_m(drive, found.poses)
    assert np.sqrt((after[:250] ** 2).mean()) < 1.0


def test_exact_positions_are_followed_to_their_noise() -> None:
    drive = make_drive(3, white_m=0.02, outliers=0.0)
    found = fused(drive)
    assert found.is_moved
    near = np.median(errors_m(drive, found.poses)[drive.fixes.at])
    assert near < 0.05


def test_positions_of_another_path_move_nothing() -> None:
    drive, other = make_drive(0), make_drive(7)
    fixes = replace(drive.fixes, xyz=other.fixes.xyz)
    found = fuse_path(drive.poses, fixes, Given(NO_LOOPS, True))
    assert found is None or not found.is_moved


def test_a_camera_that_stands_still_is_left_where_it_is() -> None:
    """Steps of length 0 have no covariance that could be inverted."""
    drive = make_drive(3, USUAL, 2.0, 0.0, 0.03)
    poses = np.repeat(drive.poses[:1], len(drive.poses), axis=0)

    found = fuse_path(poses, drive.fixes, Given(NO_LOOPS, True))

    assert found is not None
    assert not found.is_moved
    assert np.allclose(found.poses, poses, rtol=0.0, atol=1e-9)


def test_few_positions_are_not_used() -> None:
    drive = make_drive(0)
    assert fuse_path(drive.poses, drive.fixes.rows(np.arange(8)), Given(NO_LOOPS, True)) is None


def test_a_loop_holds_the_path_together() -> None:
    """Positions end before 500 s; a loop says how keyframe 590 is related to keyframe 450."""
    drive = make_drive(3, Drift(step_rad=1e-3))
    fixes = drive.fixes.rows(drive.fixes.times_s < 500.0)
    sigma = np.array([1e-5] * 3 + [0.01] * 3 + [1e-4])
    loop = LoopFactors(np.array([450]), np.array([590]), np.diag(sigma**2)[None])
    measured = inverse(drive.poses[450]) @ drive.poses[590]
    off, spread = [], []
    for loops in (loop, NO_LOOPS):
        found = fuse_path(drive.poses, fixes, Given(loops, True))
        assert found is not None and found.is_moved
        related = inverse(found.poses[450]) @ found.poses[590]
        off.append(np.linalg.norm(related[:3, 3] - measured[:3, 3]))
        spread.append(np.sqrt(np.trace(found.in_frame[590, 3:6, 3:6])))
    assert off[0] < 0.05 and off[1] > 2.0 * off[0]
    assert spread[0] < 0.9 * spread[1]


def wheel_ways(drive: Drive, noise: float, radius: float = 1.0) -> WayFactors:
    """Ways of 8 s each, with relative errors."""
    at, since = np.arange(8, 600, 8), np.arange(0, 592, 8)
    motions = inverse(drive.true_poses[:-1]) @ drive.true_poses[1:]
    length = np.linalg.norm(motions[:, :3, 3], axis=1)
    angle = np.arccos(np.clip(0.5 * (np.trace(motions[:, :3, :3], axis1=1, axis2=2) - 1), -1, 1))
    summed = np.r_[0.0, np.cumsum(length / np.sinc(0.5 * angle / np.pi))]
    way = summed[at] - summed[since]
    chords = (drive.true_poses[at] - drive.true_poses[since])[:, :3, 3]
    errors = np.random.default_rng(5).normal(0.0, max(noise, 1e-300), len(way))
    turned = np.r_[0.0, np.cumsum(angle)]
    rows = (turned[at] - turned[since] < 0.35) & (np.linalg.norm(chords, axis=1) > 0.5 * way)
    return WayFactors(
        at[rows],
        since[rows],
        (radius * way * (1.0 + errors))[rows],
        (way / np.linalg.norm(chords, axis=1))[rows],
        at[rows].astype(float),
        (max(noise, 0.002) * way[rows]) ** 2,
        0.015,
    )


def shape_error_m(drive: Drive, poses: Floats) -> float:
    aligned = umeyama(poses[:, :3, 3], drive.true_poses[:, :3, 3], with_scale=True)
    off = aligned.transform_points(poses[:, :3, 3]) - drive.true_poses[:, :3, 3]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


@pytest.mark.parametrize(("noise", "largest"), [(0.0, 0.1), (0.004, 0.3)])
def test_wheels_alone_hold_the_scale_of_one_camera(noise: float, largest: float) -> None:
    drive = make_drive(1, NEARLY_NONE._replace(log_scale=2e-3))
    ways = wheel_ways(drive, noise)
    fixes = drive.fixes.rows(np.zeros(0, np.int64))
    found = fuse_path(drive.poses, fixes, Given(NO_LOOPS, False, ways=ways))
    assert found is not None and found.is_moved
    before, after = (shape_error_m(drive, each) for each in (drive.poses, found.poses))
    assert after < largest * before
    np.testing.assert_array_less(0.0, np.linalg.eigvalsh(found.from_first[300, :6, :6]))


def test_further_rounds_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounding errors grew a hundredfold in each: the path was lost in the sixth."""
    drive = make_drive(1, NEARLY_NONE._replace(log_scale=2e-3))
    fixes, ways = drive.fixes.rows(np.zeros(0, np.int64)), wheel_ways(drive, 0.004)
    moved = []
    for rounds in (4, 8):
        monkeypatch.setattr("vo.runs.scaling.path_fusion._ROUNDS", rounds)
        found = fuse_path(drive.poses, fixes, Given(NO_LOOPS, False, ways=ways))
        assert found is not None and found.is_moved
        moved.append(found.poses)
    np.testing.assert_allclose(moved[1], moved[0], atol=0.02)  # of 5 km


def test_wheels_that_show_no_drift_move_nothing() -> None:
    drive = make_drive(1, NEARLY_NONE._replace(log_scale=1e-5))
    fixes = drive.fixes.rows(np.zeros(0, np.int64))
    ways = wheel_ways(drive, 0.01)
    found = fuse_path(drive.poses, fixes, Given(NO_LOOPS, False, ways=ways))
    assert found is not None and not found.is_moved
    np.testing.assert_allclose(found.poses, drive.poses, atol=1e-9)


def test_wheels_of_a_wrong_radius_join_positions() -> None:
    drive = make_drive(0, Drift(log_scale=2e-3))
    ways = wheel_ways(drive, 0.004, 1.02)
    without, joined = (
        fuse_path(drive.poses, drive.fixes, Given(NO_LOOPS, False, ways=each))
        for each in (None, ways)
    )
    assert without is not None and joined is not None and joined.is_moved
    errors = [np.sqrt((errors_m(drive, each.poses) ** 2).mean()) for each in (without, joined)]
    assert errors[1] < 0.8 * errors[0]
    assert 0.2 < nees(drive, joined) < 3.0
