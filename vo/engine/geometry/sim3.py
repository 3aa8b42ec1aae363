"""Similarities Sim(3) as (4, 4) arrays, and their tangent (rx ry rz tx ty tz log-scale).

    a_from_b = [ s R  t ]
               [ 0    1 ]

so that they are composed and applied like rigid motions, which have s = 1. A tangent belongs to the
frame on the right: `a_from_b @ retract(xi)` moves frame b by xi, in b's own unit. GTSAM orders the
tangent of `Similarity3` in the same way.
"""

from __future__ import annotations

import numpy as np

from vo.base.geometry.transforms import skew
from vo.base.types import Floats


def similarity(a_from_b: Floats, scale: Floats | float) -> Floats:
    """Similarities (..., 4, 4) of rigid motions (..., 4, 4) and scales (...)."""
    result = a_from_b.copy()
    result[..., :3, :3] *= np.asarray(scale)[..., None, None]
    return result


def scale_of(a_from_b: Floats) -> Floats:
    """(...) scales of similarities (..., 4, 4): length in a of one unit of b."""
    return np.asarray(np.cbrt(np.linalg.det(a_from_b[..., :3, :3])))


def rigid_part(a_from_b: Floats) -> Floats:
    """The same with scale 1: rotation, and translation in the unit of a."""
    result = a_from_b.copy()
    result[..., :3, :3] /= scale_of(a_from_b)[..., None, None]
    return result


def inverse(a_from_b: Floats) -> Floats:
    """b_from_a of similarities (..., 4, 4)."""
    result = np.zeros_like(a_from_b)
    squared = scale_of(a_from_b)[..., None, None] ** 2
    rotation = np.swapaxes(a_from_b[..., :3, :3], -1, -2) / squared
    result[..., :3, :3] = rotation
    result[..., :3, 3] = -(rotation @ a_from_b[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def adjoint(a_from_b: Floats) -> Floats:
    """(..., 7, 7) with a_from_b @ exp(xi) = exp(adjoint @ xi) @ a_from_b."""
    scaled, t = a_from_b[..., :3, :3], a_from_b[..., :3, 3]
    rotation = scaled / scale_of(a_from_b)[..., None, None]
    result = np.zeros((*a_from_b.shape[:-2], 7, 7))
    result[..., :3, :3] = rotation
    result[..., 3:6, :3] = skew(t) @ rotation
    result[..., 3:6, 3:6] = scaled
    result[..., 3:6, 6] = -t
    result[..., 6, 6] = 1.0
    return result


def retract(tangent: Floats) -> Floats:
    """Similarities (..., 4, 4) of tangents (..., 7), the exponential map to first order.

    Rotation, translation and scale are those of the tangent, each by itself.
    """
    rotvec = tangent[..., :3]
    angle = np.linalg.norm(rotvec, axis=-1)[..., None, None]
    cross = skew(rotvec)
    half_sinc = np.sinc(0.5 * angle / np.pi)
    result = np.zeros((*tangent.shape[:-1], 4, 4))
    rotation = np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half_sinc**2 * cross @ cross
    result[..., :3, :3] = np.exp(tangent[..., 6])[..., None, None] * rotation
    result[..., :3, 3] = tangent[..., 3:6]
    result[..., 3, 3] = 1.0
    return result


def local(a_from_b: Floats) -> Floats:
    """Tangents (..., 7) of similarities (..., 4, 4), the inverse of `retract`.

    The axis of a rotation by 180 degrees is arbitrary.
    """
    scale = scale_of(a_from_b)
    rotation = a_from_b[..., :3, :3] / scale[..., None, None]
    difference = rotation - np.swapaxes(rotation, -1, -2)
    axis = 0.5 * np.stack(
        [difference[..., 2, 1], difference[..., 0, 2], difference[..., 1, 0]], axis=-1
    )
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0))
    is_small = sine < 1e-12
    factor = np.where(is_small, 1.0, angle / np.where(is_small, 1.0, sine))
    result = np.empty((*scale.shape, 7))
    result[..., :3] = axis * factor[..., None]
    result[..., 0] = np.where(is_small & (angle > 1.0), angle, result[..., 0])
    result[..., 3:6] = a_from_b[..., :3, 3]
    result[..., 6] = np.log(scale)
    return result
