"""Vectors as tuples, which stay in registers."""

from __future__ import annotations

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import Pair, Rotation, Vector


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def add_scaled(start: Vector, direction: Vector, by: float) -> Vector:
    """The point start + by * direction."""
    return (
        start[0] + by * direction[0],
        start[1] + by * direction[1],
        start[2] + by * direction[2],
    )


@inlined
def subtract(a: Vector, b: Vector) -> Vector:
    """The difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def minimum(a: Vector, b: Vector) -> Vector:
    """The minimum by coordinate."""
    return min(a[0], b[0]), min(a[1], b[1]), min(a[2], b[2])


@inlined
def maximum(a: Vector, b: Vector) -> Vector:
    """The maximum by coordinate."""
    return max(a[0], b[0]), max(a[1], b[1]), max(a[2], b[2])


@inlined
def rotate(rotation: Rotation, v: Vector) -> Vector:
    """The product R v."""
    return dot(rotation[0], v), dot(rotation[1], v), dot(rotation[2], v)


@inlined
def rotate_xy(rotation: Rotation, v: Pair) -> Vector:
    """The product R (x, y, 0)."""
    return (
        rotation[0][0] * v[0] + rotation[0][1] * v[1],
        rotation[1][0] * v[0] + rotation[1][1] * v[1],
        rotation[2][0] * v[0] + rotation[2][1] * v[1],
    )


@inlined
def rotate_back(rotation: Rotation, v: Vector) -> Vector:
    """The product R^T v."""
    return (
        rotation[0][0] * v[0] + rotation[1][0] * v[1] + rotation[2][0] * v[2],
        rotation[0][1] * v[0] + rotation[1][1] * v[1] + rotation[2][1] * v[2],
        rotation[0][2] * v[0] + rotation[1][2] * v[1] + rotation[2][2] * v[2],
    )


@inlined
def axis_vector(axis: int, length: float) -> Vector:
    """The vector of a length, which may be negative, along an axis."""
    return (
        length if axis == 0 else 0.0,
        length if axis == 1 else 0.0,
        length if axis == 2 else 0.0,
    )


@inlined
def dominant_axis(vector: Vector) -> int:
    """The axis along which a vector is longest."""
    x, y, z = abs(vector[0]), abs(vector[1]), abs(vector[2])
    if x >= y and x >= z:
        return 0
    return 1 if y >= z else 2


@inlined
def reciprocal(value: float) -> float:
    """1 / value, without infinity for 0."""
    return 1.0 / (value if value != 0.0 else 1e-300)


@inlined
def tangent_basis(normal: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors orthogonal to a unit vector and to each other.

    Source: Duff et al., Building an Orthonormal Basis, Revisited, 2017.
    """
    x, y, z = normal
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)
