"""Rigid motion SE(3) as (4, 4) arrays, its tangent (rx ry rz tx ty tz) and quaternions xyzw."""

from __future__ import annotations

import math

import numpy as np

from vo.base.types import Floats

# Maximum error of a rotation that a single Newton step corrects; its square remains.
_MAX_ROUNDING = 1e-8
_IDENTITY = np.eye(3)


def make_transform(rotation: Floats, translation: Floats) -> Floats:
    """A (4, 4) transform from a (3, 3) rotation and a translation of three numbers."""
    transform = np.zeros((4, 4))
    transform[:3, :3] = rotation
    transform[:3, 3] = np.asarray(translation).reshape(3)
    transform[3, 3] = 1.0
    return transform


def whole_transforms(rows: Floats) -> Floats:
    """Append the row 0 0 0 1 to transforms (N, 3, 4)."""
    result = np.zeros((len(rows), 4, 4))
    result[:, :3] = rows
    result[:, 3, 3] = 1.0
    return result


def inverse(a_from_b: Floats) -> Floats:
    """b_from_a of one (4, 4) or many (..., 4, 4) transforms."""
    if a_from_b.ndim == 2:  # two thirds of the time of the general case
        single = np.zeros((4, 4))
        single[:3, :3] = back = a_from_b[:3, :3].T
        single[:3, 3] = -(back @ a_from_b[:3, 3])
        single[3, 3] = 1.0
        return single
    result = np.zeros_like(a_from_b)
    rotation = np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    result[..., :3, :3] = rotation
    result[..., :3, 3] = -(rotation @ a_from_b[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def transform_points(a_from_b: Floats, points: Floats) -> Floats:
    """Transform (N, 3) points from frame b to frame a."""
    return np.asarray(points @ a_from_b[:3, :3].T + a_from_b[:3, 3])


def skew(vector: Floats) -> Floats:
    """(..., 3, 3) matrices of the cross products with vectors (..., 3)."""
    result = np.zeros((*vector.shape, 3))
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -z, y, -x
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = z, -y, x
    return result


def so3_exp(rotvec: Floats) -> Floats:
    """Rotation matrix of a rotation vector in radians (Rodrigues)."""
    return _rotation(*_angle_and_skew(rotvec))


def so3_log(rotation: Floats) -> Floats:
    """Rotation vector in radians of a (3, 3) rotation, with an angle in [0, pi]."""
    x, y, z, w = quat_xyzw_of_rows(rotation.tolist())
    axis, w = (np.array([x, y, z]), w) if w >= 0 else (np.array([-x, -y, -z]), -w)
    sine = math.sqrt(axis.dot(axis))
    return np.asarray(axis * (2.0 if sine < 1e-12 else 2.0 * np.arctan2(sine, w) / sine))


def se3_exp(tangent: Floats) -> Floats:
    """Transform of a tangent vector (rx ry rz tx ty tz).

    Source: Barfoot, State Estimation for Robotics, 2017, eq. 7.33 and 7.37.
    """
    angle, k = _angle_and_skew(tangent[:3])
    return make_transform(_rotation(angle, k), _left_jacobian(angle, k) @ tangent[3:])


def se3_log(transform: Floats) -> Floats:
    """Tangent vector (rx ry rz tx ty tz) of a transform; the inverse of `se3_exp`."""
    rotvec = so3_log(transform[:3, :3])
    return np.concatenate(
        [rotvec, np.linalg.solve(_left_jacobian(*_angle_and_skew(rotvec)), transform[:3, 3])]
    )


def adjoint(a_from_b: Floats) -> Floats:
    """(..., 6, 6) with exp(adjoint @ xi) = a_from_b @ exp(xi) @ b_from_a, rotation first."""
    rotation = a_from_b[..., :3, :3]
    result = np.zeros((*a_from_b.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotation
    result[..., 3:, :3] = skew(a_from_b[..., :3, 3]) @ rotation
    return result


def interpolate(first: Floats, second: Floats, fraction: float) -> Floats:
    """The pose at `fraction` (0 is first, 1 is second) on the SE(3) geodesic between two poses."""
    return np.asarray(first @ se3_exp(fraction * se3_log(inverse(first) @ second)))


def orthonormalised(transform: Floats) -> Floats:
    """The same transform with the nearest orthonormal rotation.

    Errors of rounding are corrected by one step of Newton's method, in a fifth of the time of the
    SVD that is used otherwise.

    Source: Higham, "Computing the polar decomposition", 1986, eq. 3.1.
    """
    matrix = transform[:3, :3]
    # Mean of the matrix and its inverse transposed, whose rows are cross products.
    first, second, third = matrix.tolist()
    values = [*first, *second, *third]
    crossed = [*_cross(second, third), *_cross(third, first), *_cross(first, second)]
    determinant = values[0] * crossed[0] + values[1] * crossed[1] + values[2] * crossed[2]
    if abs(determinant - 1.0) < _MAX_ROUNDING:
        means = [0.5 * (a + b / determinant) for a, b in zip(values, crossed, strict=True)]
        if all(abs(a - b) < _MAX_ROUNDING for a, b in zip(values, means, strict=True)):
            return make_transform(np.array(means).reshape(3, 3), transform[:3, 3])
    u, _, vt = np.linalg.svd(matrix)
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return make_transform(rotation, transform[:3, 3])


def _cross(a: list[float], b: list[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def rotation_angle(rotation: Floats) -> float:
    """Angle of a (3, 3) rotation in radians."""
    return float(np.linalg.norm(so3_log(rotation)))


def rotation_from_quat_xyzw(quat_xyzw: Floats) -> Floats:
    """(..., 3, 3) rotations of (..., 4) quaternions; they need not be of unit length."""
    x, y, z, w = np.moveaxis(quat_xyzw / np.linalg.norm(quat_xyzw, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_xyzw_from_rotation(rotation: Floats) -> Floats:
    """Unit quaternion of one (3, 3) rotation (Shepperd 1978: the largest component first)."""
    return np.array(quat_xyzw_of_rows(rotation.tolist()))


def quat_xyzw_of_rows(m: list[list[float]]) -> list[float]:
    """The same of nested lists, much faster than arrays; further columns make no difference."""
    (xx, xy, xz, *_), (yx, yy, yz, *_), (zx, zy, zz, *_) = m
    trace, largest = xx + yy + zz, max(xx, yy, zz)
    if trace > largest:
        x, y, z, w = zy - yz, xz - zx, yx - xy, 1.0 + trace
    elif largest == xx:
        x, y, z, w = 1.0 - trace + 2.0 * xx, yx + xy, zx + xz, zy - yz
    elif largest == yy:
        x, y, z, w = yx + xy, 1.0 - trace + 2.0 * yy, zy + yz, xz - zx
    else:
        x, y, z, w = zx + xz, zy + yz, 1.0 - trace + 2.0 * zz, yx - xy
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return [x / length, y / length, z / length, w / length]


def _angle_and_skew(rotvec: Floats) -> tuple[float, Floats]:
    """Length of a rotation vector, and its (3, 3) matrix of the cross product."""
    x, y, z = rotvec.tolist()
    # By `dot`, as in numpy.linalg.norm: sums of plain products differ in the last bit.
    return math.sqrt(rotvec.dot(rotvec)), np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _rotation(angle: float, k: Floats) -> Floats:
    if angle < 1e-8:
        return np.asarray(_IDENTITY + k + 0.5 * k @ k)
    half_sine = np.sin(0.5 * angle) / angle
    return np.asarray(_IDENTITY + (np.sin(angle) / angle) * k + 2.0 * half_sine**2 * k @ k)


def _left_jacobian(angle: float, k: Floats) -> Floats:
    """Left Jacobian (3, 3) of SO(3)."""
    if angle < 1e-6:
        return np.asarray(_IDENTITY + 0.5 * k + k @ k / 6.0)
    # 1 - cos by the half angle: the plain form loses all digits as the angle gets small.
    half_sine = np.sin(0.5 * angle) / angle
    return np.asarray(
        _IDENTITY + 2.0 * half_sine**2 * k + ((angle - np.sin(angle)) / angle**3) * k @ k
    )
