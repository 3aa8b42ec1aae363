"""Pieces of a path that wheel odometry joins, across frames without a pose.

How exact a join is shows where images know the motion as well: gaps of the same length are
pretended there, and bridged by the wheels.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import adjoint, inverse, se3_exp
from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Bools, Floats, Ints
from vo.engine.geometry import sim3
from vo.engine.trajectory.store import TrajectoryStore
from vo.runs.scaling.wheel_fit import WheelFit
from vo.runs.scaling.wheel_odometry import WheelOdometry
from vo.runs.scaling.wheel_source import WheelSource

_MAX_GAP_S = 60.0
_PRETENDED, _MIN_PRETENDED = 60, 4  # gaps
_GROWTH = 1.5  # exponent of errors with the length of a gap
_WAY_RATIO, _TURN_RATIO = 0.005, 0.02  # standard deviations at least, of way and turn
_STRAIGHT_RAD = 0.05  # turn of a gap up to which the direction up need not be known
_ROUNDS, _STEP, _LEAST = 3, 1e-5, 1e-6  # of the fit to pretended gaps, and of its derivatives
# Standard deviations before it: of the pose of the base, and of ratios of its turns and ways.
_MOUNT, _KNOWN_MOUNT = (0.05, 0.05, 0.05, 0.15, 0.15, 0.15), (0.01, 0.01, 0.01, 0.01, 0.01, 0.01)
_TURN_SIGMA, _WAY_SIGMA = 0.02, 0.01


class Join(NamedTuple):
    """A piece that follows another one by the wheels.

    Attributes:
        keyframe: id of its first one.
        sigma: (7,) standard deviations of the motion across the gap, and of the change of the
            logarithm of the scale, in the frame of that keyframe.
        note: a sentence for the user.
    """

    keyframe: int
    sigma: Floats
    note: str


def join_pieces(store: TrajectoryStore, wheel: WheelSource, kept: Collection[int]) -> list[Join]:
    """Place later worlds of a path in metres by the wheels since the frame before them.

    Args:
        store: the path, whose keyframes are moved.
        wheel: after `measure`.
        kept: worlds that stay where they are.
    """
    path, joins = store.path(), []
    for row in np.flatnonzero(np.diff(path.world) != 0).tolist():
        before, after = path.world[row : row + 2].tolist()
        is_new = not (path.world[:row] == after).any() and after not in kept
        if (
            is_new
            and before in wheel.fits
            and after in wheel.fits
            and store.metric.is_metric(after)
        ):
            found = _joined(store, wheel, path, row)
            joins += [] if found is None else [found]
    return joins


def _joined(store: TrajectoryStore, wheel: WheelSource, path: PosedFrames, row: int) -> Join | None:
    """Join the world that begins after a row of the path; None where that is not certain."""
    worlds, stamps_ns = path.world[row : row + 2].tolist(), path.trajectory.stamps_ns
    gap_s = 1e-9 * float(stamps_ns[row + 1] - stamps_ns[row])
    fits = [wheel.fits[world] for world in worlds]
    mount = max(fits, key=lambda fit: (fit.is_known or fit.has_up, fit.used))
    unit_m = [1.0 if (s := store.metric.scale(w)) is None else s.value for w in worlds]
    lengths = [fit.scale / unit for fit, unit in zip(fits, unit_m, strict=True)]
    pretended = _pretended(path, list(zip(worlds, lengths, strict=True)), gap_s)
    across = _Gaps(
        stamps_ns[row : row + 1], stamps_ns[row + 1 : row + 2], np.array([np.mean(lengths)])
    )
    bridge = _Bridge(wheel.wheel, mount)
    is_known = bridge.motions(across, bridge.start)[1]
    is_straight = mount.is_known or mount.has_up or abs(bridge.turns(across)[0]) < _STRAIGHT_RAD
    if not is_known[0] or gap_s > _MAX_GAP_S or not is_straight or pretended is None:
        return None
    found = bridge.fitted(pretended, across)
    if found is None:
        return None
    motion, covariance = found
    way, turn = float(np.linalg.norm(motion[:3, 3])), abs(float(bridge.turns(across)[0]))
    least = np.r_[np.full(3, _TURN_RATIO * turn), np.full(3, _WAY_RATIO * way)]
    covariance += np.diag(least**2)
    ends = path.trajectory.world_from_cam[row : row + 2]
    keyframe = _place(store, worlds, ends, motion, covariance)
    sigma = np.r_[np.sqrt(np.diag(covariance)), 0.0]
    if not store.metric.by_cameras:
        sigma[6] = np.linalg.norm([fit.sigma / fit.scale for fit in fits])
    note = (
        f"segment {worlds[1]} follows segment {worlds[0]} by the wheels alone: {gap_s:.1f} s and "
        f"{way:.3g} m without images (standard deviation {np.sqrt(np.mean(sigma[3:6] ** 2)):.2g} m)"
    )
    return Join(keyframe, sigma, note)


class _Gaps(NamedTuple):
    """N gaps.

    Attributes:
        begin_ns: (N,) times.
        end_ns: as above.
        length: (N,) metres of the wheels for one of the path.
    """

    begin_ns: Ints
    end_ns: Ints
    length: Floats


class _Pretended(NamedTuple):
    """Gaps where images know the motions (N, 4, 4), and by which errors of wheels are larger."""

    gaps: _Gaps
    motions: Floats
    growth: Floats
    independent: float  # how many of them


class _Bridge:
    """Motions of the camera by the wheels alone.

    A calibration (8,) is a change of the pose of the base in the camera (6,), and of the logarithms
    of its turns and ways.
    """

    def __init__(self, wheel: WheelOdometry, mount: WheelFit) -> None:
        self.start = np.zeros(8)
        self._wheel, self._mount = wheel, mount
        mounting = _KNOWN_MOUNT if mount.is_known else _MOUNT
        self._prior = np.r_[mounting, _TURN_SIGMA, _WAY_SIGMA]

    def turns(self, gaps: _Gaps) -> Floats:
        """(N,) to the left."""
        return self._ends(gaps)[1][:, 1] - self._ends(gaps)[0][:, 1]

    def motions(self, gaps: _Gaps, calibration: Floats) -> tuple[Floats, Bools]:
        """(N, 4, 4), and where (N,) they are known."""
        begin, end, is_known = self._ends(gaps)
        heading, turn = begin[:, 1], (end - begin)[:, 1] * np.exp(calibration[6])
        xy = (end - begin)[:, 2:] * (np.exp(calibration[7]) / gaps.length)[:, None]
        # The headings on the way are too small in the same proportion.
        back = -heading + 0.5 * (turn - (end - begin)[:, 1])
        moved = np.tile(np.eye(4), (len(turn), 1, 1))
        moved[:, :2, :2] = _turned(turn)
        moved[:, :2, 3] = np.einsum("nij,nj->ni", _turned(back), xy)
        base = self._mount.cam0_from_base @ se3_exp(calibration[:6])
        return base @ moved @ inverse(base), is_known

    def fitted(self, given: _Pretended, across: _Gaps) -> tuple[Floats, Floats] | None:
        """The motion (4, 4) across a gap by the best calibration, and its covariance (6, 6)."""
        known = self.motions(given.gaps, self.start)[1]
        if known.sum() < _MIN_PRETENDED:
            return None
        begin_ns, end_ns, length = given.gaps
        gaps = _Gaps(begin_ns[known], end_ns[known], length[known])
        motions, growth = given.motions[known], given.growth[known][:, None]
        alike = np.sqrt(known.sum() / given.independent)  # of errors that overlap
        calibration, covariance = self.start, np.diag(self._prior**2)
        for _ in range(_ROUNDS):
            found, design = self._errors(gaps, motions, calibration)
            sigma = alike * np.sqrt((found**2).mean(axis=0)) + _LEAST
            a = (design / sigma[:, None]).reshape(-1, 8)
            information = a.T @ a + np.diag(self._prior**-2)
            gradient = a.T @ (found / sigma).ravel() + calibration / self._prior**2
            covariance = np.linalg.inv(information)
            calibration = calibration - covariance @ gradient
        left = growth * self._errors(gaps, motions, calibration)[0]
        motion = self.motions(across, calibration)[0]
        by_calibration = self._errors(across, motion, calibration)[1][0]
        spread = left.T @ left / len(left) + by_calibration @ covariance @ by_calibration.T
        return motion[0], spread

    def _errors(self, gaps: _Gaps, motions: Floats, calibration: Floats) -> tuple[Floats, Floats]:
        """(N, 6) tangents from true motions to those by wheels, and derivatives (N, 6, 8)."""
        back = inverse(motions)
        found, *moved = (
            sim3.local(back @ self.motions(gaps, calibration + step)[0])[:, :6]
            for step in (np.zeros(8), *(_STEP * np.eye(8)))
        )
        return found, np.stack([(each - found) / _STEP for each in moved], axis=2)

    def _ends(self, gaps: _Gaps) -> tuple[Floats, Floats, Bools]:
        late_ns = round(1e9 * self._mount.offset_s)
        begin, first = self._wheel.at(gaps.begin_ns + late_ns)
        end, last = self._wheel.at(gaps.end_ns + late_ns)
        is_known = (first >= 0) & (first == last) & (self._wheel.heading_rad is not None)
        return begin, end, is_known


def _turned(angle: Floats) -> Floats:
    """(N, 2, 2) rotations to the left."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)


def _pretended(
    path: PosedFrames, pieces: list[tuple[int, float]], gap_s: float
) -> _Pretended | None:
    """Gaps of the same length, or shorter ones, in pieces given by their numbers and lengths."""
    stamps_ns, poses = path.trajectory.stamps_ns, path.trajectory.world_from_cam
    found, independent = [], 0.0
    for world, length in pieces:
        rows = np.flatnonzero(path.world == world)
        span_s = 1e-9 * float(stamps_ns[rows[-1]] - stamps_ns[rows[0]])
        pretended_s = min(gap_s, 0.5 * span_s)
        later = np.searchsorted(stamps_ns[rows], stamps_ns[rows] + int(1e9 * pretended_s))
        begins = np.flatnonzero(later < len(rows))
        if pretended_s <= 0.0 or len(begins) == 0:
            continue
        chosen = np.linspace(0, len(begins) - 1, min(len(begins), _PRETENDED)).astype(int)
        begins = begins[np.unique(chosen)]
        # A few independent ones say little of the standard deviation.
        growth = (gap_s / pretended_s) ** _GROWTH * np.sqrt(1.0 + 2.0 * pretended_s / span_s)
        independent += max(span_s / pretended_s - 1.0, 1.0)
        alike = np.ones(len(begins))
        found.append((rows[begins], rows[later[begins]], length * alike, growth * alike))
    if not found:
        return None
    begin, end, lengths, growth = (np.concatenate(each) for each in zip(*found, strict=True))
    gaps = _Gaps(stamps_ns[begin], stamps_ns[end], lengths)
    return _Pretended(gaps, inverse(poses[begin]) @ poses[end], growth, independent)


def _place(
    store: TrajectoryStore, worlds: list[int], ends: Floats, motion: Floats, measured: Floats
) -> int:
    """Move the second world to where the first one ends; the id of its first keyframe.

    `ends`: (2, 4, 4) frames beside the gap. `measured`: (6, 6) covariance of their motion.
    """
    ids, world_from_cam, scale, covariance = store.registered(worlds[1])
    moved = ends[0] @ motion @ inverse(ends[1]) @ world_from_cam
    first_world = store.world(worlds[0])
    at = store.registered(first_world)
    known = np.flatnonzero(np.isfinite(at[3]).all(axis=(1, 2)) & (at[0] < ids[0]))
    if len(known):
        along = adjoint(inverse(moved) @ at[1][known[-1]])
        covariance = covariance + along @ at[3][known[-1]] @ np.swapaxes(along, 1, 2)
        across = adjoint(inverse(moved) @ moved[0])
        covariance += across @ measured @ np.swapaxes(across, 1, 2)
    segments = {each.segment for each in store.keyframes_by_id(ids.tolist())}
    scales = {segment: store.metric.scale(segment) for segment in segments}
    found = {segment: each for segment, each in scales.items() if each is not None}
    store.metric.scales = {**store.metric.scales, **found}
    store.move_keyframes(ids, np.full(len(ids), first_world), moved, scale, covariance)
    return int(ids[0])
