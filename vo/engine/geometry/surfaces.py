"""Local surface orientation of points, from neighbouring points."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.geometry.projection import Intrinsics
from vo.base.types import Floats, Ints

_RADIUS_PX = 100.0  # of the neighbourhood
_SCALE_PX = 30.0  # distance at which the weight of a neighbour has fallen to a half
# Maximum relative difference of inverse depth; neighbours that differ more are on another surface.
_MAX_DIFFERENCE = 0.3
_SIGMA_DEPTH = 0.05  # standard deviation of relative inverse depth about a plane
_SIGMA_SLOPE = 0.02  # prior standard deviation of slopes, 1/px
_ITERATIONS = 3  # of reweighting
_MAX_CELLS = 200  # along each side, because undistorted pixels are not bounded by the image


def inverse_depth_slopes(xy: Floats, inverse_depth: Floats, of: Ints) -> Floats:
    """Gradient of inverse depth in the image relative to inverse depth, at some points.

    Inverse depth is an affine function of the pixel on a plane. A plane through the point is fitted
    to its neighbours with Cauchy weights, and a prior of slope 0 (parallel to the image plane). A
    road has a slope of 1 / 60 downwards 60 rows below the horizon.

    Args:
        xy: (N, 2) undistorted pixels of points with known depth.
        inverse_depth: (N,) positive, in any unit.
        of: (n,) rows of the points to compute.

    Returns:
        (n, 2) in 1/px.
    """
    return np.asarray(_slopes(np.ascontiguousarray(xy), np.ascontiguousarray(inverse_depth), of))


def surface_normals(
    xy: Floats,
    depth: Floats,
    of: Ints,
    world_from_cam: Floats,
    intrinsics: Intrinsics,
) -> Floats:
    """Surface normals (n, 3) of any length in the world, at some points.

    Of undistorted pixels (N, 2) with positive depths (N,) those `of` (n,), seen by a camera (4, 4).
    """
    fx, fy, cx, cy = intrinsics
    slope, at = inverse_depth_slopes(xy, 1.0 / depth, of), xy[of] - (cx, cy)
    # 1 / depth = n . (x, y, 1) on the plane n . X = 1.
    in_cam = np.empty((len(of), 3))
    in_cam[:, :2] = slope * (fx, fy)
    slope *= at
    in_cam[:, 2] = 1.0 - (slope[:, 0] + slope[:, 1])
    return np.asarray(in_cam @ world_from_cam[:3, :3].T)


def left_from_right(disparity: Floats, slope: Floats) -> Floats:
    """Warps (N, 2, 2) of pixel offsets from the right image to the left one.

    Args:
        disparity: (N,) pixels.
        slope: (N, 2) relative gradient of inverse depth in the left image, equal to that of
            disparity, 1/px.
    """
    return np.asarray(_left_from_right(disparity, slope))


@compiled
def _left_from_right(disparity, slope):  # type: ignore[no-untyped-def]
    back = np.zeros((len(disparity), 2, 2))
    for n in range(len(disparity)):
        shrink, shear = 1.0 - disparity[n] * slope[n, 0], disparity[n] * slope[n, 1]
        back[n, 0, 0] = 1.0 / min(max(shrink, 0.5), 2.0)
        back[n, 0, 1] = min(max(shear, -1.5), 1.5) * back[n, 0, 0]
        back[n, 1, 1] = 1.0
    return back


@compiled
def _slopes(xy, inverse_depth, of):  # type: ignore[no-untyped-def]
    """See `inverse_depth_slopes`; neighbours are searched in the 3 x 3 cells around a point."""
    slopes = np.zeros((len(of), 2))
    column, row, columns, first, order = _by_cell(xy)
    u, v, sorted_inverse = xy[order, 0], xy[order, 1], inverse_depth[order]
    # Offsets of the neighbours, and their inverse depths relative to the point's, less 1.
    dx, dy, more = np.empty(len(xy)), np.empty(len(xy)), np.empty(len(xy))
    for i in range(len(of)):
        n = of[i]
        x, y, by_own = xy[n, 0], xy[n, 1], 1.0 / inverse_depth[n]
        count = np.uintp(0)
        for r in range(max(row[n] - 1, 0), row[n] + 2):
            begin = r * columns + max(column[n] - 1, 0)
            end = r * columns + min(column[n] + 2, columns)
            if begin >= len(first) - 1:
                break
            stop = np.uintp(first[min(end, len(first) - 1)])
            for k in range(np.uintp(first[begin]), stop):
                right, down, nearer = u[k] - x, v[k] - y, sorted_inverse[k] * by_own - 1.0
                near = (right * right + down * down <= _RADIUS_PX**2) & (order[k] != n)
                dx[count], dy[count], more[count] = right, down, nearer
                # Without a branch: rejected neighbours are overwritten by the next.
                count += np.uintp(near & (abs(nearer) <= _MAX_DIFFERENCE))
        slopes[i, 0], slopes[i, 1] = _fitted(dx[:count], dy[:count], more[:count])
    return slopes


@compiled(
    fastmath={"reassoc", "contract"}, error_model="numpy", **NO_REFCOUNT
)  # for vector instructions
def _fitted(dx, dy, more):  # type: ignore[no-untyped-def]
    """Slopes (gx, gy) of more = gx dx + gy dy by iteratively reweighted least squares."""
    gx = gy = 0.0
    for number in range(_ITERATIONS):
        xx = yy = 1.0 / _SIGMA_SLOPE**2
        xy = bx = by = 0.0
        robust = 0.0 if number == 0 else 1.0 / _SIGMA_DEPTH**2
        for m in range(np.uintp(len(dx))):
            residual = more[m] - gx * dx[m] - gy * dy[m]
            squared = (dx[m] * dx[m] + dy[m] * dy[m]) * (1.0 / _SCALE_PX**2)
            w = (1.0 / _SIGMA_DEPTH**2) / ((1.0 + squared) * (1.0 + robust * residual * residual))
            xx += w * dx[m] * dx[m]
            yy += w * dy[m] * dy[m]
            xy += w * dx[m] * dy[m]
            bx += w * dx[m] * more[m]
            by += w * dy[m] * more[m]
        determinant = xx * yy - xy * xy
        gx, gy = (bx * yy - by * xy) / determinant, (by * xx - bx * xy) / determinant
    return gx, gy


@compiled
def _by_cell(xy):  # type: ignore[no-untyped-def]
    """Column and row of each point's cell (side `_RADIUS_PX`), number of columns, points by cell.

    The points of cell c are `order[first[c] : first[c + 1]]`.
    """
    column, row = np.zeros(len(xy), dtype=np.int64), np.zeros(len(xy), dtype=np.int64)
    columns, rows = 1, 1
    if len(xy) > 0:
        left, top = xy[0, 0], xy[0, 1]
        for n in range(len(xy)):
            left, top = min(left, xy[n, 0]), min(top, xy[n, 1])
        for n in range(len(xy)):
            column[n] = int(min((xy[n, 0] - left) / _RADIUS_PX, _MAX_CELLS - 1))
            row[n] = int(min((xy[n, 1] - top) / _RADIUS_PX, _MAX_CELLS - 1))
            columns, rows = max(columns, column[n] + 1), max(rows, row[n] + 1)
    first = np.zeros(columns * rows + 1, dtype=np.int64)
    for n in range(len(xy)):
        first[row[n] * columns + column[n] + 1] += 1
    for c in range(columns * rows):
        first[c + 1] += first[c]
    order, filled = np.empty(len(xy), dtype=np.int64), first[:-1].copy()
    for n in range(len(xy)):
        cell = row[n] * columns + column[n]
        order[filled[cell]] = n
        filled[cell] += 1
    return column, row, columns, first, order
