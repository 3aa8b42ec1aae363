"""The pinhole projection and its derivatives, for compiled code.

    u = fx x / z + cx,    v = fy y / z + cy,    d = fx b / z

of a point (x, y, z) in the camera's frame, with baseline b between the cameras of a pair.

The functions are inlined into the kernels that call them, and compiled with the kernel's own
options, so they cost nothing. The order of operations is part of the result: a kernel gets the
same bits from them only as long as nobody reorders them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.types import Floats

MIN_DEPTH = 1e-6  # z below which a point counts as behind the camera


class PixelObservations(NamedTuple):
    """N observations of points by a camera, or by the left camera of a rectified pair.

    Attributes:
        xy: (N, 2) undistorted pixels.
        disparity: (N,) u_left - u_right in pixels, NaN where there is none.
        sigma_px: (N,) standard deviation of u and of v.
        sigma_disparity_px: standard deviation of a disparity.
    """

    xy: Floats
    disparity: Floats
    sigma_px: Floats
    sigma_disparity_px: float


class Intrinsics(NamedTuple):
    """Focal lengths and principal point of a pinhole camera, in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def from_matrix(cls, matrix: Floats) -> Intrinsics:
        """Intrinsics of a (3, 3) camera matrix."""
        return cls(*(float(matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))))


_inlined = compiled(inline="always", **NO_REFCOUNT)


@_inlined
def to_camera(cam_from_world: Any, x: Any, y: Any, z: Any) -> Any:
    """A point of the world in the camera's frame; cam_from_world is (3, 4) or (4, 4)."""
    t = cam_from_world
    return (
        t[0, 0] * x + t[0, 1] * y + t[0, 2] * z + t[0, 3],
        t[1, 0] * x + t[1, 1] * y + t[1, 2] * z + t[1, 3],
        t[2, 0] * x + t[2, 1] * y + t[2, 2] * z + t[2, 3],
    )


@_inlined
def from_world(world_from_cam: Any, x: Any, y: Any, z: Any) -> Any:
    """The same for the inverse pose: R^T (p - t) with R and t of world_from_cam."""
    t = world_from_cam
    dx, dy, dz = x - t[0, 3], y - t[1, 3], z - t[2, 3]
    return (
        t[0, 0] * dx + t[1, 0] * dy + t[2, 0] * dz,
        t[0, 1] * dx + t[1, 1] * dy + t[2, 1] * dz,
        t[0, 2] * dx + t[1, 2] * dy + t[2, 2] * dz,
    )


@_inlined
def project(intrinsics: Any, x: Any, y: Any, z: Any) -> Any:
    """Pixel u, v of a point in the camera's frame, where no derivative is needed."""
    return intrinsics.fx * x / z + intrinsics.cx, intrinsics.fy * y / z + intrinsics.cy


@_inlined
def pixel(intrinsics: Any, x: Any, y: Any, inverse_z: Any) -> Any:
    """The same with 1 / z, which derivatives share; 1 for normalised x / z and y / z."""
    return (
        intrinsics.fx * x * inverse_z + intrinsics.cx,
        intrinsics.fy * y * inverse_z + intrinsics.cy,
    )


@_inlined
def point_derivatives(fx: Any, fy: Any, fb: Any, x: Any, y: Any, scale: Any, inverse_z: Any) -> Any:
    """Derivatives of u, v, d by the point in the camera's frame.

    fx, fy and fb may have weights as factors, each its own. x, y are as in `pixel`, with `scale`
    as its last argument: 1 / z, or 1 where x and y are normalised.

    Returns:
        du/dx, dv/dy, du/dz, dv/dz, dd/dz; the others are 0.
    """
    ux, vy = fx * inverse_z, fy * inverse_z
    return ux, vy, -ux * x * scale, -vy * y * scale, -fb * inverse_z * inverse_z


@_inlined
def by_world_axis(derivatives: Any, r0: Any, r1: Any, r2: Any) -> Any:
    """Derivatives of u, v, d by a world axis, whose direction in the camera's frame is r."""
    ux, vy, uz, vz, dz = derivatives
    return ux * r0 + uz * r2, vy * r1 + vz * r2, dz * r2


@_inlined
def by_world_from_cam(derivatives: Any, x: Any, y: Any, z: Any) -> Any:
    """Derivatives of u, v, d by xi = (rx ry rz tx ty tz) of world_from_cam @ exp(xi).

    The motion of the camera moves a point (x, y, z) in its frame by -(t + r x p).

    Returns:
        Three rows of six.
    """
    ux, vy, uz, vz, dz = derivatives
    return (
        (-uz * y, uz * x - ux * z, ux * y, -ux, 0.0, -uz),
        (vy * z - vz * y, vz * x, -vy * x, 0.0, -vy, -vz),
        (-dz * y, dz * x, 0.0, 0.0, 0.0, -dz),
    )


@_inlined
def by_cam_from_world(fx: Any, fy: Any, x: Any, y: Any, inverse_z: Any) -> Any:
    """Derivatives of u, v by xi = (rx ry rz tx ty tz) of exp(xi) @ cam_from_world.

    x, y are normalised. fx and fy may have a weight as factor.

    Returns:
        Two rows of six.
    """
    return (
        (-fx * x * y, fx * (1.0 + x * x), -fx * y, fx * inverse_z, 0.0, -fx * x * inverse_z),
        (-fy * (1.0 + y * y), fy * x * y, fy * x, 0.0, fy * inverse_z, -fy * y * inverse_z),
    )
