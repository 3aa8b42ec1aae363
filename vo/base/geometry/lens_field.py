"""Fields of view of lenses, and whether one pinhole camera holds them."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.cameras import project_wide
from vo.base.types import Camera, Floats

WIDE_DEG = 62.0
"""Beyond this angle from its axis a lens is wider than a pinhole camera should be."""

_MAX_DEG = 100.0  # from the axis: what lies beyond it in an image is no scene
_STEP_DEG = 2  # of the search for the edge of an image


def reach(lens: Camera) -> float:
    """The greatest angle from the optical axis that is used."""
    if lens.distortion_model == "equirectangular":
        return np.pi
    return float(min(max(half_angles(lens)), np.deg2rad(_MAX_DEG)))


def half_angles(lens: Camera) -> tuple[float, float]:
    """The greatest angles from the optical axis to edges of the image: across it, and along."""
    if lens.distortion_model == "equirectangular":
        return np.pi, np.pi / 2
    return _half_angle(lens, 0), _half_angle(lens, 1)


def _half_angle(lens: Camera, axis: int) -> float:
    angles = np.deg2rad(np.arange(0, 180, _STEP_DEG))
    greatest = 0.0
    for side in (-1.0, 1.0):
        rays: Floats = np.zeros((len(angles), 3))
        rays[:, axis], rays[:, 2] = side * np.sin(angles), np.cos(angles)
        at = project_wide(lens, rays)[:, axis]
        end = (lens.width, lens.height)[axis] - 1
        with np.errstate(invalid="ignore"):
            inside = (at >= 0) & (at <= end) & (np.diff(at, prepend=at[0] - side) * side > 0)
        beyond = np.flatnonzero(~inside)
        last = (beyond[0] if len(beyond) else len(angles)) - 1
        greatest = max(greatest, float(angles[max(last, 0)]))
    return greatest
