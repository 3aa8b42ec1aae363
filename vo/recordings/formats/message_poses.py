"""Conversion of vectors, positions and quaternions of messages to arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from vo.base.errors import SourceError
from vo.base.geometry.transforms import make_transform, rotation_from_quat_xyzw
from vo.base.types import Floats

_MAX_DISTANCE_M = 1e12


def vector3(vector: Any) -> Floats:
    """The coordinates x, y, z as (3,)."""
    return np.array([vector.x, vector.y, vector.z])


def rigid_transform(position: Any, rotation: Any) -> Floats:
    """The (4, 4) transform of a position (x, y, z) and a quaternion (x, y, z, w)."""
    quat = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    xyz = np.array([position.x, position.y, position.z])
    if not (np.isfinite(quat).all() and np.any(quat) and (np.abs(xyz) < _MAX_DISTANCE_M).all()):
        raise SourceError(f"position {xyz.tolist()} with quaternion {quat.tolist()} is not a pose")
    return make_transform(rotation_from_quat_xyzw(quat), xyz)
