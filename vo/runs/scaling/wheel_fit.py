"""The fit of a path to wheel odometry: length of its unit, lever arm, clock, noise and slip."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse, make_transform, so3_exp, so3_log
from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Bools, Floats, Ints
from vo.runs.scaling.wheel_odometry import WheelOdometry

_MIN_STEP_S, _MAX_STEP_S, _MAX_STEPS = 0.2, 3.0, 1500
_MIN_MOVING = 10  # steps
_STANDING = 0.1  # of the median way of steps that move
_OFFSETS_S = np.arange(-1.0, 1.001, 0.05)
_FINER_S = np.arange(-0.05, 0.0501, 0.01)
_MIN_OFFSET_S, _OFFSET_GAIN = 0.01, 25.0  # of the cost: five standard deviations
_OVERLAP, _BESIDE_S = 0.8, 0.3  # offsets that are compared
_NEAR = 25  # steps on each side that one is compared with
_REFUSED, _REFUSED_OVERALL = 5.0, 8.0  # standard deviations
_SMALLEST = 0.003  # of the way of a step: smaller differences are no slip
_ARM_SIGMA_M, _MIN_TURN = 0.5, 0.3  # rad, all turns: fewer show no lever arm
_MAX_OFF = 0.35  # rad, of a motion from the direction ahead
_BLOCKS = 10
_MEDIAN = 0.6745
_NS_PER_S = 1_000_000_000


class Steps(NamedTuple):
    """N steps between frames of the path, each within one segment.

    Attributes:
        begin_ns: (N,) times.
        end_ns: as above.
        motion: (N, 3) in the frame of the camera half-way, as long as an arc.
        turn: (N, 3) rotation vectors.
        arm: (N, 3) what the base moves more than the camera: metres, 0 for an unknown lever arm.
    """

    begin_ns: Ints
    end_ns: Ints
    motion: Floats
    turn: Floats
    arm: Floats


class WheelFit(NamedTuple):
    """What wheel odometry says about a world.

    Attributes:
        scale: metres of the wheels for one unit of the path.
        sigma: its standard deviation, without that of the wheels' radius.
        offset_s: by which their clock is late.
        cam0_from_base: (4, 4) rotation, and translation in metres; the height is unknown.
        is_known: whether that was given.
        has_up: whether turns show the direction up.
        arm_m: (2,) lever arm of the camera, ahead and to the left; 0 if it is known.
        noise: variance of a way, by its length in metres.
        used: number of steps.
        slips_ns: (S, 2) steps in which wheels and images differ.
        spread: relative standard deviation of the ways of ten parts of the path.
    """

    scale: float
    sigma: float
    offset_s: float
    cam0_from_base: Floats
    is_known: bool
    has_up: bool
    arm_m: Floats
    noise: float
    used: int
    slips_ns: Ints
    spread: float

    def forward(self, steps: Steps, ways: Floats) -> tuple[Floats, Floats]:
        """(N,) ways of the camera ahead: by the path, and by the ways of the wheels."""
        in_base = self.cam0_from_base[:3, :3]
        by_arm = (steps.arm @ in_base)[:, 0] + self.arm_m[1] * (steps.turn @ in_base[:, 2])
        return (steps.motion @ in_base)[:, 0], ways - by_arm

    @property
    def refused_ratio(self) -> float:
        """Of the steps."""
        return len(self.slips_ns) / max(len(self.slips_ns) + self.used, 1)


def make_steps(path: PosedFrames, world: int, wheel: WheelOdometry) -> Steps:
    """Steps of at least 0.2 s in one world, at most about 1,500."""
    rows = np.flatnonzero(path.world == world)
    stamps_ns = path.trajectory.stamps_ns[rows]
    span_s = 1e-9 * float(np.ptp(stamps_ns)) if len(rows) else 0.0
    step_ns = int(_NS_PER_S * max(_MIN_STEP_S, span_s / _MAX_STEPS))
    chosen, last = [], -step_ns
    for row, stamp_ns in zip(rows.tolist(), (stamps_ns - stamps_ns[:1]).tolist(), strict=True):
        if stamp_ns - last >= step_ns:
            chosen.append(row)
            last = stamp_ns
    nodes = np.array(chosen, np.int64)
    times, segments = path.trajectory.stamps_ns[nodes], path.segment[nodes]
    return steps_between(times, segments, path.trajectory.world_from_cam[nodes], wheel)[0]


def steps_between(
    times_ns: Ints, segments: Ints, poses: Floats, wheel: WheelOdometry
) -> tuple[Steps, Bools]:
    """Steps from each of some poses to the next; which of these are near each other."""
    near = (np.diff(times_ns) <= _MAX_STEP_S * _NS_PER_S) & (np.diff(segments) == 0)
    motions = (inverse(poses[:-1]) @ poses[1:])[near]
    turn = np.array([so3_log(each[:3, :3]) for each in motions]).reshape(-1, 3)
    half = np.array([so3_exp(-0.5 * each) for each in turn]).reshape(-1, 3, 3)
    arc = 1.0 / np.sinc(0.5 * np.linalg.norm(turn, axis=1) / np.pi)
    motion = arc[:, None] * (half @ motions[:, :3, 3, None])[:, :, 0]
    arm = np.zeros_like(motion)
    if wheel.cam0_from_base is not None:
        lever = wheel.cam0_from_base[:3, 3]
        arm = arc[:, None] * (half @ (motions[:, :3, :3] @ lever - lever)[:, :, None])[:, :, 0]
    return Steps(times_ns[:-1][near], times_ns[1:][near], motion, turn, arm), near


def fit_wheel(steps: Steps, wheel: WheelOdometry) -> WheelFit | str:
    """Fit the ways of wheels to those of a path, or say why that cannot be done."""
    ways, valid = ways_of(steps, wheel, 0.0)
    moving = valid & (np.abs(ways) > _STANDING * _usual(ways[valid]))
    if moving.sum() < _MIN_MOVING:
        return f"only {int(moving.sum())} steps of the path are at times at which wheels turn"
    mount = _mount(steps, ways, moving, wheel.cam0_from_base)
    if mount is None:
        return "the camera moves in no steady direction while the wheels turn"
    cam0_from_base, has_up = mount
    best = _with_clock(steps, wheel, cam0_from_base)
    if best.scale <= 0.0:
        return "the wheels turn backwards while the camera moves forward"
    return best.result(steps, cam0_from_base, wheel.cam0_from_base is not None, has_up)


def _with_clock(steps: Steps, wheel: WheelOdometry, cam0_from_base: Floats) -> _Fitted:
    """The best fit; with an offset of the clocks only where the changes of the speed show it."""
    plain = _Fitted.of(steps, wheel, cam0_from_base, 0.0)
    best, tried = plain, [plain]
    for offsets in (_OFFSETS_S, _FINER_S):
        found = [
            _Fitted.of(steps, wheel, cam0_from_base, best.offset_s + further)
            for further in offsets.tolist()
        ]
        tried += [each for each in found if each.rows.sum() >= _OVERLAP * plain.rows.sum()]
        best = min(tried, key=lambda each: each.cost)
    beside = [each.cost for each in tried if abs(each.offset_s - best.offset_s) > _BESIDE_S]
    gain = (min([plain.cost, *beside]) - best.cost) / max(best.cost / len(best.rows), 1e-300)
    return plain if abs(best.offset_s) < _MIN_OFFSET_S or gain < _OFFSET_GAIN else best


class _Fitted(NamedTuple):
    """A fit for one offset of the clocks; `noise`: median variance of a way, by its length."""

    offset_s: float
    ways: Floats
    rows: Bools
    forward: Floats
    yaw: Floats
    left: Floats
    scale: float
    arm_left_m: float
    used: Bools
    noise: float
    cost: float

    @classmethod
    def of(
        cls, steps: Steps, wheel: WheelOdometry, cam0_from_base: Floats, offset_s: float
    ) -> _Fitted:
        ways, rows = ways_of(steps, wheel, offset_s)
        in_base = steps.motion @ cam0_from_base[:3, :3]
        by_arm = (steps.arm @ cam0_from_base[:3, :3])[:, 0]
        yaw = steps.turn @ cam0_from_base[:3, 2]
        is_free = wheel.cam0_from_base is None and np.abs(yaw[rows]).sum() > _MIN_TURN
        forward, target = in_base[:, 0], ways - by_arm
        weight = 1.0 / np.sqrt(np.abs(ways) + _STANDING * _usual(ways[rows]) + 1e-9)
        used, solution, noise = rows.copy(), np.zeros(2), 1.0
        for _ in range(6):
            design = np.column_stack([forward, yaw if is_free else np.zeros_like(yaw)])
            prior = np.sqrt(noise) / _ARM_SIGMA_M
            a = np.vstack([design[used] * weight[used, None], [0.0, prior]])
            solution = np.linalg.lstsq(a, np.r_[target[used] * weight[used], 0.0], rcond=None)[0]
            left = (target - design @ solution) * weight
            found, noise = _agreeing(left, rows, _SMALLEST * np.abs(ways) * weight)
            if not found.any():
                break
            used = found
        cost = float(np.minimum(left[rows] ** 2, _REFUSED**2 * noise).sum()) * _share(rows)
        scale, arm = solution.tolist()
        return cls(
            *(offset_s, ways, rows, forward, yaw, in_base[:, 1]),
            *(scale, arm, used, noise, cost),
        )

    def result(
        self, steps: Steps, cam0_from_base: Floats, is_known: bool, has_up: bool
    ) -> WheelFit:
        """The fit with its uncertainty."""
        target = self.ways - (steps.arm @ cam0_from_base[:3, :3])[:, 0] - self.arm_left_m * self.yaw
        rows = np.flatnonzero(self.used)
        blocks = np.array_split(rows, _BLOCKS)
        lengths = np.array([self.scale * self.forward[each].sum() for each in blocks])
        off = np.array([target[each].sum() for each in blocks]) - lengths
        moves = np.abs(lengths) > _STANDING * np.abs(lengths).mean()
        spread = float(np.sqrt(np.mean((off[moves] / lengths[moves]) ** 2))) if moves.any() else 1.0
        way = np.abs(target[rows]).sum()
        sigma = np.hypot(spread / np.sqrt(max(moves.sum() - 1, 1)), np.sqrt(self.noise / way))
        found, arm = cam0_from_base, np.zeros(2)
        squares = float((self.yaw[rows] ** 2).sum())
        if not is_known and has_up:
            ahead = self.scale * float(self.left[rows] @ self.yaw[rows]) / max(squares, 1e-300)
            arm = np.array([ahead, self.arm_left_m])
            base = -(cam0_from_base[:3, :2] @ arm)
            found = make_transform(cam0_from_base[:3, :3], base)
        slips = np.flatnonzero(self.rows & ~self.used)
        return WheelFit(
            *(self.scale, self.scale * float(sigma), self.offset_s, found, is_known, has_up, arm),
            *(self.noise, len(rows), np.column_stack([steps.begin_ns, steps.end_ns])[slips]),
            spread,
        )


def ways_of(steps: Steps, wheel: WheelOdometry, offset_s: float) -> tuple[Floats, Bools]:
    """(N,) of the wheels in each step, and whether they are known."""
    late_ns = round(offset_s * _NS_PER_S)
    begin, part = wheel.at(steps.begin_ns + late_ns)
    end, end_part = wheel.at(steps.end_ns + late_ns)
    return end[:, 0] - begin[:, 0], (part >= 0) & (part == end_part)


def _usual(ways: Floats) -> float:
    """Median way of the steps that move."""
    lengths = np.abs(ways)
    moving = lengths[lengths > 0.05 * lengths.max(initial=0.0)]
    return float(np.median(moving)) if len(moving) else 0.0


def _share(rows: Bools) -> float:
    """So that a clock at which few steps are known is not preferred."""
    return len(rows) / max(int(rows.sum()), 1)


def _agreeing(left: Floats, rows: Bools, smallest: Floats) -> tuple[Bools, float]:
    """Steps that are near the median of their neighbours, and not too far from that of all.

    Also the variance about that of the neighbours: a scale that drifts is no noise.
    """
    used = np.zeros(len(left), bool)
    known = np.flatnonzero(rows)
    values = left[known]
    near = np.clip(
        np.arange(len(known))[:, None] + np.arange(-_NEAR, _NEAR + 1), 0, max(len(known) - 1, 0)
    )
    off = np.abs(values - np.median(values[near], axis=1))
    overall = np.abs(values - np.median(values))
    for distance, limit in ((off, _REFUSED), (overall, _REFUSED_OVERALL)):
        sigma = np.maximum(np.median(distance) / _MEDIAN, smallest[known])
        if limit == _REFUSED:
            used[known] = distance <= limit * sigma
        else:
            used[known] &= distance <= limit * sigma
    return used, max(float(np.median(off) / _MEDIAN) ** 2, 1e-12)


def _mount(
    steps: Steps, ways: Floats, moving: Bools, given: Floats | None
) -> tuple[Floats, bool] | None:
    """(4, 4) orientation of the base (x ahead, z up) in the camera, and whether turns show it.

    Ahead is where the camera moves while the wheels roll forward, and up the axis of its turns;
    without turns the camera is taken to be upright.
    """
    if given is not None:
        return given, True
    length = np.linalg.norm(steps.motion, axis=1)
    rows = np.flatnonzero(moving & (length > 0.0))
    directions = np.sign(ways[rows])[:, None] * steps.motion[rows] / length[rows, None]
    turned = np.linalg.norm(steps.turn[rows], axis=1) / np.maximum(np.abs(ways[rows]), 1e-9)
    straight = turned <= np.median(turned)
    ahead = np.median(directions[straight], axis=0)
    norm = float(np.linalg.norm(ahead))
    if norm < np.cos(_MAX_OFF):
        return None
    ahead /= norm
    if np.median(directions[straight] @ ahead) < np.cos(_MAX_OFF):
        return None
    turns = steps.turn[moving] - (steps.turn[moving] @ ahead)[:, None] * ahead
    _, _, axes = np.linalg.svd(turns, full_matrices=False)
    up = axes[0]
    across = np.abs(turns @ np.cross(ahead, up)).sum()
    about = np.abs(turns @ up).sum()
    has_up = bool(about > _MIN_TURN and about > 3.0 * across)
    if not has_up:
        up = np.array([0.0, -1.0, 0.0]) - ahead * -ahead[1]
    up *= np.sign(-up[1]) or 1.0
    up = up / np.linalg.norm(up)
    rotation = np.column_stack([ahead, np.cross(up, ahead), up])
    return make_transform(rotation, np.zeros(3)), has_up
