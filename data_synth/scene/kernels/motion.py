"""Image motion of surfaces during the exposure, to first order."""

from __future__ import annotations

from data_synth.scene.kernels.camera import pixel_ray, pose_at
from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import NOTHING, ZERO, Pair, Sweep, View
from data_synth.scene.kernels.vectors import add_scaled, rotate, rotate_back, subtract
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.types import Floats


@inlined
def exposure_sweep(shutter: Shutter, row: int) -> Sweep:
    """Motion of points in the camera's frame from the start to the end of a row's exposure.

    A point at t = 1/w on a ray r moves by (D r + w e) / w. Returns D, as rows, and e.
    """
    if shutter.width == 0.0:
        return (ZERO, ZERO, ZERO), ZERO
    middle, _, _ = pose_at(shutter, 1, row, 0.0)
    first, first_origin, _ = pose_at(shutter, 1, row, -0.5)
    last, last_origin, _ = pose_at(shutter, 1, row, 0.5)
    # With R, o of the middle and P = o + R r / w in the world, R_k^T (P - o_k) at both ends gives
    # D = (R_last - R_first)^T R, whose row k is R^T times column k of the difference, and
    # e = R^T (o_first - o_last), to first order.
    c = (subtract(last[0], first[0]), subtract(last[1], first[1]), subtract(last[2], first[2]))
    d = (
        rotate_back(middle, (c[0][0], c[1][0], c[2][0])),
        rotate_back(middle, (c[0][1], c[1][1], c[2][1])),
        rotate_back(middle, (c[0][2], c[1][2], c[2][2])),
    )
    return d, rotate_back(middle, subtract(first_origin, last_origin))


@inlined
def pixel_motion(
    world: World,
    shutter: Shutter,
    rays: Floats,
    sweep: Sweep,
    view: View,
    row: int,
    column: int,
) -> Pair:
    """Motion, in pixels across and down, of the surface point hit by the centre ray of a pixel."""
    number = view.surface[row, column]
    if shutter.width == 0.0 or number == NOTHING:
        return 0.0, 0.0
    inverse = 1.0 / view.depth[row, column]
    return surface_motion(world, shutter, rays, sweep, inverse, number, row, column)


@inlined
def surface_motion(
    world: World,
    shutter: Shutter,
    rays: Floats,
    sweep: Sweep,
    inverse: float,
    number: int,
    row: int,
    column: int,
) -> Pair:
    """Motion, in pixels across and down, of a surface of inverse depth `inverse` at a pixel.

    With m = D r + w (e + velocity * exposure), the ray (x, y, 1) changes by (m_x - x m_z,
    m_y - y m_z); the inverse of the derivatives of the ray by column and row gives pixels.
    """
    if shutter.width == 0.0:
        return 0.0, 0.0
    (x, y), across, down = pixel_ray(rays, row, column)
    d, e = sweep
    moved = add_scaled(rotate(d, (x, y, 1.0)), e, inverse)
    mover = number // 6 - len(world.bounds)
    if 0 <= mover < len(world.movers.bodies):
        v = world.movers.velocities[mover]
        rotation, _, _ = pose_at(shutter, 1, row, 0.0)
        velocity = rotate_back(rotation, (v[0], v[1], v[2]))
        moved = add_scaled(moved, velocity, shutter.width * shutter.step_s * inverse)
    mx, my = moved[0] - x * moved[2], moved[1] - y * moved[2]
    area = across[0] * down[1] - across[1] * down[0]
    if area == 0.0:  # a pixel without neighbours at the border of the image circle
        return 0.0, 0.0
    scale = 1.0 / area
    right = scale * (mx * down[1] - my * down[0])
    below = scale * (across[0] * my - across[1] * mx)
    # Rolling shutter: a point that moves down by v rows is exposed later by v * per_row poses,
    # which are v * per_row / width exposures, and moves on meanwhile. Solve for v:
    # v = below * (1 + v * per_row / width). The factor is limited to 2.
    if shutter.per_row != 0.0:
        late = 1.0 / (1.0 - min(below * shutter.per_row / shutter.width, 0.5))
        right, below = late * right, late * below
    return right, below
