"""Courses for paths, without a world."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from data_synth.scene.scene import Course, flat_ground
from vo.base.types import Floats

ROUND = 2.0 * np.pi * np.arange(16) / 16


def _hills(points: Floats) -> Floats:
    return 4.0 * np.sin(points[:, 0] / 25.0) + 3.0 * np.cos(points[:, 1] / 18.0)


COURSES: dict[str, Course] = {
    "ring": Course(
        np.column_stack([2.0 * np.cos(ROUND), 1.5 * np.sin(ROUND)]), 0.6, 2.7, flat_ground(), 60.0
    ),
    "rectangle": Course(
        np.array([[75.0, -45.0], [75.0, 45.0], [-75.0, 45.0], [-75.0, -45.0]]),
        3.0,
        12.0,
        flat_ground(),
    ),
    "aisles": Course(
        np.array(
            [[0, 0], [20, 0], [20, 15], [10, 15], [10, 6], [5, 6], [5, 15], [0, 15]], dtype=float
        ),
        1.5,
        6.0,
        flat_ground(),
    ),
    "hills": Course(
        np.array(
            [[120, 0], [60, 100], [-60, 100], [-120, 0], [-60, -100], [60, -100]], dtype=float
        ),
        30.0,
        100.0,
        _hills,
    ),
}

LOOP_S = {"ring": 20.0, "rectangle": 90.0, "aisles": 90.0, "hills": 150.0}


def walls(course: Course, half_width_m: float) -> Callable[[Floats], Floats]:
    """Distances, or less, to walls on both sides of a course, with sharp corners."""
    starts = course.waypoints
    sides = np.roll(starts, -1, axis=0) - starts
    lengths = np.linalg.norm(sides, axis=1)
    ahead = sides / lengths[:, None]

    def clearance(points: Floats) -> Floats:
        # The free space about each side is a rectangle that reaches over both of its ends.
        relative = points[:, None, :2] - starts
        along = (relative * ahead).sum(axis=2)
        across = np.abs(relative[..., 1] * ahead[:, 0] - relative[..., 0] * ahead[:, 1])
        beyond = np.maximum(np.maximum(-along, along - lengths), across)
        return np.asarray((half_width_m - beyond).max(axis=1))

    return clearance
