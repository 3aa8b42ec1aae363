"""Smooth paths: uniform cubic B-splines, twice continuously differentiable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.base.types import Floats

# Basis of the uniform cubic B-spline; rows are powers 1, s, s², s³ of the position between knots.
_BASIS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
_ROUNDING = 1e-6

# Columns: the axes right, down and forward of a camera that faces along the body's x.
BODY_FROM_LOOKING_AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def bspline(controls: Floats, at: Floats, derivative: int = 0, lap: Floats | None = None) -> Floats:
    """Values (N, C) of a uniform cubic B-spline, or its first or second derivative.

    A value is a weighted mean of four controls, and so within their range; a derivative is within
    the range of their differences.

    `controls`: (K, C); control k has its largest weight at k. `at`: (N,) positions in steps between
    controls: 1…K-2 for an open spline, any for a closed one. `derivative`: 0, 1 or 2, per step.
    `lap`: for a closed spline, (C,) increment of each lap; None for an open one.

    Raises:
        ValueError: a position outside an open spline.
    """
    at = np.asarray(at, dtype=np.float64)
    first = np.floor(at).astype(np.int64)
    if lap is None:
        last = len(controls) - 2
        if len(at) and (at.min() < 1.0 - _ROUNDING or at.max() > last + _ROUNDING):
            raise ValueError(f"positions {at.min():g}…{at.max():g} are outside the spline 1…{last}")
        first = np.clip(first, 1, last - 1)  # the end belongs to the last piece
    fraction = at - first
    powers = np.zeros((len(at), 4))
    for power in range(derivative, 4):
        factor = np.prod(np.arange(power, power - derivative, -1, dtype=np.float64))
        powers[:, power] = factor * fraction ** (power - derivative)
    index = first[:, None] + np.arange(-1, 3)
    local = controls[index % len(controls)]
    if lap is not None:
        local = local + (index // len(controls))[..., None] * lap
    return np.asarray(np.einsum("nk,nkc->nc", powers @ _BASIS, local))


@dataclass(frozen=True, eq=False)
class PosePath:
    """A path of the body, with x ahead, y to the left and z up.

    Positive pitch lifts the nose, positive roll lowers the right side.
    """

    # (K, 6) controls of x, y, z in metres and yaw, pitch, roll in radians in the world; yaw is
    # continuous
    controls: Floats
    step_s: float  # time between controls
    lead: int  # number of controls before time 0
    duration_s: float  # duration; an open path extends slightly before 0 and after the end
    # for a closed path, full turns of yaw in K steps; None for an open path
    turns: int | None = None

    def world_from_body(self, times_s: Floats) -> Floats:
        """Poses (N, 4, 4) at times (N,)."""
        values = self._values(times_s, 0)
        poses = np.zeros((len(values), 4, 4))
        poses[:, :3, :3] = rotations(values[:, 3], values[:, 4], values[:, 5])
        poses[:, :3, 3] = values[:, :3]
        poses[:, 3, 3] = 1.0
        return poses

    def velocity(self, times_s: Floats) -> Floats:
        """Velocities (N, 3) in the world, m/s."""
        return self._values(times_s, 1)[:, :3]

    def acceleration(self, times_s: Floats) -> Floats:
        """Accelerations (N, 3) in the world without gravity, m/s²."""
        return self._values(times_s, 2)[:, :3]

    def angular_velocity(self, times_s: Floats) -> Floats:
        """Angular velocities (N, 3) in the body, rad/s.

        Source: Diebel, Representing Attitude, 2006, eq. 74, with pitch of the opposite sign.
        """
        pitch, roll = self._values(times_s, 0)[:, 4:].T
        yaw_rate, pitch_rate, roll_rate = self._values(times_s, 1)[:, 3:].T
        about_x = roll_rate + yaw_rate * np.sin(pitch)
        about_y = yaw_rate * np.cos(pitch) * np.sin(roll) - pitch_rate * np.cos(roll)
        about_z = yaw_rate * np.cos(pitch) * np.cos(roll) + pitch_rate * np.sin(roll)
        return np.column_stack([about_x, about_y, about_z])

    def _values(self, times_s: Floats, derivative: int) -> Floats:
        lap = None
        if self.turns is not None:
            lap = np.array([0.0, 0.0, 0.0, 2.0 * np.pi * self.turns, 0.0, 0.0])
        at = np.asarray(times_s, dtype=np.float64) / self.step_s + self.lead
        return bspline(self.controls, at, derivative, lap) / self.step_s**derivative


def rotations(yaw: Floats, pitch: Floats, roll: Floats) -> Floats:
    """world_from_body (N, 3, 3): roll about x, then pitch about -y, then yaw about z."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    cr, sr = np.cos(roll), np.sin(roll)
    ahead = np.stack([cy * cp, sy * cp, sp], axis=-1)
    left = np.stack([-sy * cr - cy * sp * sr, cy * cr - sy * sp * sr, cp * sr], axis=-1)
    return np.stack([ahead, left, np.cross(ahead, left)], axis=-1)
