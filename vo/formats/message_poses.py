"""Turns vectors, positions and quaternions, as messages have them, into arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from vo.errors import SourceError
from vo.geometry.transforms import make_transform, rotation_from_quat_xyzw
from vo.types import Floats

_FURTHEST_M = 1e12


def vector3(vector: Any) -> Floats:
    """The (3,) numbers x, y, z."""
    return np.array([vector.x, vector.y, vector.z])


def rigid_transform(position: Any, rotation: Any) -> Floats:
    """The (4, 4) transform of a position (x, y, z) and a quaternion (x, y, z, w).

    Raises:
        SourceError: a number is not finite or beyond all measure, or the quaternion is zero.
    """
    quat = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    place = np.array([position.x, position.y, position.z])
    if not (np.isfinite(quat).all() and np.any(quat) and (np.abs(place) < _FURTHEST_M).all()):
        raise SourceError(f"position {place.tolist()} with quaternion {quat.tolist()} is no pose")
    return make_transform(rotation_from_quat_xyzw(quat), place)
