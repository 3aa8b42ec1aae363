"""Ways of wheels as factors between keyframes."""

from __future__ import annotations

import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.runs.scaling.path_factors import WayFactors
from vo.runs.scaling.wheel_fit import WheelFit, steps_between, ways_of
from vo.runs.scaling.wheel_odometry import WheelOdometry

_FACTORS = 80  # of a path
_MIN_FACTORS = 6
_MAX_TURN = 0.35  # rad, within one: its length must say nothing of turns
_MIN_CHORD = 0.5  # of the way
_WAY_SIGMA = 0.002  # of each way, besides its noise, at least
_MEDIAN = 0.6745


def way_factors(
    poses: Floats, stamps_ns: Ints, segments: Ints, wheel: WheelOdometry, fit: WheelFit
) -> tuple[Ints, Ints, Floats, Floats, Floats] | None:
    """Ends, beginnings, ways, bends and times of about 80 parts without slip; None for too few.

    `poses`: (n, 4, 4) keyframes in metres.
    """
    steps, near = steps_between(stamps_ns, segments, poses, wheel)
    ways, valid = ways_of(steps, wheel, fit.offset_s)
    by_path, by_wheel = fit.forward(steps, ways)
    slips = fit.slips_ns
    begin, end = steps.begin_ns[:, None], steps.end_ns[:, None]
    slipped = ((begin < slips[:, 1]) & (end > slips[:, 0])).any(axis=1)
    first = np.flatnonzero(near)
    turn = np.linalg.norm(steps.turn, axis=1)
    parts = _parts(first, by_wheel, turn, valid & ~slipped)
    found = []
    for rows in parts:
        since, at = int(first[rows[0]]), int(first[rows[-1]]) + 1
        chord = float(np.linalg.norm(poses[at, :3, 3] - poses[since, :3, 3]))
        way, length = float(by_wheel[rows].sum()), float(by_path[rows].sum())
        if chord > _MIN_CHORD * abs(length) > 0.0 and way * length > 0.0:
            time_s = 0.5e-9 * float(stamps_ns[since] + stamps_ns[at] - 2 * stamps_ns[0])
            found.append((at, since, abs(way), abs(length) / chord, time_s))
    if len(found) < _MIN_FACTORS:
        return None
    ends = np.array([each[:2] for each in found], np.int64).T
    values = np.array([each[2:] for each in found]).T
    return ends[0], ends[1], values[0], values[1], values[2]


def with_noise(
    poses: Floats,
    found: tuple[Ints, Ints, Floats, Floats, Floats],
    fit: WheelFit,
    radius_sigma: float,
) -> WayFactors:
    """Factors with the variances of their ways, of which neighbours show a part."""
    at, since, way, bend, time_s = found
    left = np.log(way / (bend * np.linalg.norm(poses[at, :3, 3] - poses[since, :3, 3], axis=1)))
    apart = np.median(np.abs(np.diff(left, 2))) / _MEDIAN / np.sqrt(6.0)
    variance = fit.noise * way + (max(_WAY_SIGMA, apart) * way) ** 2
    return WayFactors(at, since, way, bend, time_s, variance, radius_sigma)


def _parts(first: Ints, ways: Floats, turn: Floats, usable: Bools) -> list[list[int]]:
    """Rows of consecutive steps, of about equal ways and small turns."""
    longest = float(np.abs(ways[usable]).sum()) / _FACTORS
    parts: list[list[int]] = []
    open_part: list[int] = []
    way = turned = 0.0
    for row in np.flatnonzero(usable).tolist():
        follows = bool(open_part) and first[row] == first[open_part[-1]] + 1
        if open_part and (not follows or way >= longest or turned + turn[row] > _MAX_TURN):
            parts.append(open_part)
            open_part, way, turned = [], 0.0, 0.0
        open_part.append(row)
        way, turned = way + abs(float(ways[row])), turned + float(turn[row])
    return [*parts, open_part] if open_part else parts
