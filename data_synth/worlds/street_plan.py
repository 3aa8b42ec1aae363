"""Plan of the town: positions of roads, pavements and fronts.

Four streets form a rectangle and go on beyond its corners. Distances are from the middle of a
street: lane, kerb, parking bays, pavement, fronts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.scene.builder import Place
from vo.base.types import Floats

HALF_X_M, HALF_Y_M = 75.0, 45.0  # of the rectangle of the streets' middle lines
LANE_M, KERB_M, BAY_M, FRONT_M = 2.0, 4.0, 6.0, 9.5
PAVEMENT_M = FRONT_M - BAY_M
ARM_M = 58.0  # length of streets beyond the crossings
HOUSE_DEPTH_M = 10.0
CORNER_M = 8.0  # from the middle lines to the centre of a rounded kerb
PAVED_Z_M = 0.12


@dataclass(frozen=True)
class Frontage:
    """One side of a street between two crossings."""

    place: Place  # middle of the line of fronts, facing the street
    length: float  # of the line of fronts, metres
    left: float = 0.0  # length without houses at the left end, for those around the corner
    right: float = 0.0
    on_loop: bool = True  # whether it is along the course


def frontages() -> tuple[Frontage, ...]:
    """All frontages: around the inner block, opposite it, and along the arms."""
    long, short = 2 * (HALF_X_M - FRONT_M), 2 * (HALF_Y_M - FRONT_M)
    corner = HOUSE_DEPTH_M + 1.0
    sides: list[Frontage] = []
    for turn in (0.0, np.pi):
        inner = Place(0.0, _signed(turn, HALF_Y_M - FRONT_M), np.pi - turn)
        outer = Place(0.0, _signed(turn, HALF_Y_M + FRONT_M), -turn)
        sides += [Frontage(inner, long), Frontage(outer, long)]
        inner = Place(_signed(turn, HALF_X_M - FRONT_M), 0.0, np.pi / 2 - turn)
        outer = Place(_signed(turn, HALF_X_M + FRONT_M), 0.0, -np.pi / 2 - turn)
        sides += [Frontage(inner, short, corner, corner), Frontage(outer, short)]
    reach = ARM_M - FRONT_M
    middle = FRONT_M + reach / 2
    for x_sign in (-1.0, 1.0):
        for y_sign in (-1.0, 1.0):
            up = 0.0 if y_sign > 0 else np.pi
            out = np.pi / 2 if x_sign > 0 else -np.pi / 2
            x, y = x_sign * HALF_X_M, y_sign * HALF_Y_M
            sides += [
                # Along the arm in x: the outer corner block, then the block beside the loop.
                _arm(x + x_sign * middle, y + y_sign * FRONT_M, up, reach),
                _arm(x + x_sign * middle, y - y_sign * FRONT_M, np.pi - up, reach, corner),
                # Along the arm in y.
                _arm(x + x_sign * FRONT_M, y + y_sign * middle, -out, reach, corner),
                _arm(x - x_sign * FRONT_M, y + y_sign * middle, out, reach, corner),
            ]
    return tuple(sides)


def lane(offset_m: float, radius_m: float) -> Floats:
    """A closed route (K, 2), counter-clockwise, `offset_m` outside the middle line.

    It begins with a straight side.
    """
    x, y = HALF_X_M + offset_m - radius_m, HALF_Y_M + offset_m - radius_m
    arc = np.linspace(0.0, np.pi / 2, 9)
    parts = []
    for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        turn = arc + k * np.pi / 2
        parts.append(np.array([sx * x, sy * y]) + radius_m * _unit(turn))
    return np.roll(np.concatenate(parts), -(len(arc) - 1), axis=0)


def crossings() -> tuple[tuple[float, float], ...]:
    """Points where the middle lines of streets meet."""
    return tuple((x, y) for x in (-HALF_X_M, HALF_X_M) for y in (-HALF_Y_M, HALF_Y_M))


def _arm(x: float, y: float, yaw: float, reach: float, corner: float = 0.0) -> Frontage:
    # The end at the crossing is the left or the right one, depending on the yaw of the front.
    towards = -np.sign(np.cos(yaw) * x + np.sin(yaw) * y)
    left, right = (corner, 0.0) if towards < 0 else (0.0, corner)
    return Frontage(Place(x, y, yaw), reach, left, right, on_loop=False)


def _signed(turn: float, value: float) -> float:
    return value if turn == 0.0 else -value


def _unit(angle: Floats) -> Floats:
    return np.column_stack([np.cos(angle), np.sin(angle)])
