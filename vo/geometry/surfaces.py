"""How the surfaces that points lie on are inclined, told by the points beside them."""

from __future__ import annotations

import numpy as np

from vo.compiling.function import NO_REFCOUNT, compiled
from vo.geometry.projection import Intrinsics
from vo.types import Floats, Ints

_REACH_PX = 100.0  # points farther away tell nothing
_FADE_PX = 30.0  # and those farther than this less and less
_MOST_DIFFERENT = 0.3  # inverse depth, relative: farther apart they lie on another surface
# Standard deviation of relative inverse depth about a plane, and of slopes as such, 1/px.
_NOISE, _USUAL = 0.05, 0.02
_PASSES = 3  # of reweighting
_MOST_CELLS = 200  # a side: undistorted pixels may lie anywhere


def inverse_depth_slopes(xy: Floats, inverse_depth: Floats, of: Ints) -> Floats:
    """How inverse depth changes from pixel to pixel at some points, relative to it.

    A plane's inverse depth is an affine function of the pixel: one is fitted through the point to
    those around it, robustly (Cauchy), and held back by a prior of 0, a surface that faces the
    camera. A road 60 rows below the horizon has a slope of 1 / 60 downwards.

    Args:
        xy: (N, 2) ideal pixels of points whose depth is known.
        inverse_depth: (N,) of them, in any unit, above 0.
        of: (n,) rows of the points that are asked for.

    Returns:
        (n, 2) gradients of inverse depth by its value, 1/px.
    """
    return np.asarray(_slopes(np.ascontiguousarray(xy), np.ascontiguousarray(inverse_depth), of))


def surface_normals(
    xy: Floats,
    depth: Floats,
    of: Ints,
    world_from_cam: Floats,
    intrinsics: Intrinsics,
) -> Floats:
    """Normals (n, 3), of any length, in the world, of the surfaces at some points.

    Args:
        xy: (N, 2) ideal pixels of points.
        depth: (N,) their depths, above 0.
        of: (n,) rows of the points that are asked for.
        world_from_cam: (4, 4) of the camera that sees them.
        intrinsics: of that camera.
    """
    fx, fy, cx, cy = intrinsics
    slope, at = inverse_depth_slopes(xy, 1.0 / depth, of), xy[of] - (cx, cy)
    # 1 / depth = n . (x, y, 1) on the plane n . X = 1.
    ahead = 1.0 - np.sum(slope * at, axis=1)
    in_cam = np.column_stack([slope * (fx, fy), ahead])
    return np.asarray(in_cam @ world_from_cam[:3, :3].T)


def left_from_right(disparity: Floats, slope: Floats) -> Floats:
    """(N, 2, 2) that take steps of pixels in the right image to the left one.

    Args:
        disparity: (N,) pixels.
        slope: (N, 2) of inverse depth in the left image, 1/px; disparity has the same.
    """
    stretch = 1.0 / np.clip(1.0 - disparity * slope[:, 0], 0.5, 2.0)
    back = np.zeros((len(disparity), 2, 2))
    back[:, 0, 0] = stretch
    back[:, 0, 1] = np.clip(disparity * slope[:, 1], -1.5, 1.5) * stretch
    back[:, 1, 1] = 1.0
    return back


@compiled
def _slopes(xy, inverse_depth, of):  # type: ignore[no-untyped-def]
    slopes = np.zeros((len(of), 2))
    column, row, columns, first, order = _by_cell(xy)
    u, v, told = xy[order, 0], xy[order, 1], inverse_depth[order]
    # Steps to those beside, and how much nearer they are.
    dx, dy, more = np.empty(len(xy)), np.empty(len(xy)), np.empty(len(xy))
    for i in range(len(of)):
        n = of[i]
        x, y, by_own = xy[n, 0], xy[n, 1], 1.0 / inverse_depth[n]
        count = 0
        for r in range(max(row[n] - 1, 0), row[n] + 2):
            begin = r * columns + max(column[n] - 1, 0)
            end = r * columns + min(column[n] + 2, columns)
            if begin >= len(first) - 1:
                break
            for k in range(first[begin], first[min(end, len(first) - 1)]):
                right, down, nearer = u[k] - x, v[k] - y, told[k] * by_own - 1.0
                near = (right * right + down * down <= _REACH_PX**2) & (order[k] != n)
                dx[count], dy[count], more[count] = right, down, nearer
                # Without a branch: what does not count is written over.
                count += int(near & (abs(nearer) <= _MOST_DIFFERENT))
        slopes[i, 0], slopes[i, 1] = _fitted(dx[:count], dy[:count], more[:count])
    return slopes


@compiled(
    fastmath={"reassoc", "contract"}, error_model="numpy", **NO_REFCOUNT
)  # in vector instructions
def _fitted(dx, dy, more):  # type: ignore[no-untyped-def]
    gx = gy = 0.0
    for number in range(_PASSES):
        xx = yy = 1.0 / _USUAL**2
        xy = bx = by = 0.0
        robust = 0.0 if number == 0 else 1.0 / _NOISE**2
        for m in range(np.uintp(len(dx))):
            residual = more[m] - gx * dx[m] - gy * dy[m]
            squared = (dx[m] * dx[m] + dy[m] * dy[m]) * (1.0 / _FADE_PX**2)
            w = (1.0 / _NOISE**2) / ((1.0 + squared) * (1.0 + robust * residual * residual))
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
    """Columns and rows of cells as large as the reach, and the points ordered by cell."""
    column, row = np.zeros(len(xy), dtype=np.int64), np.zeros(len(xy), dtype=np.int64)
    columns, rows = 1, 1
    if len(xy) > 0:
        left, top = xy[0, 0], xy[0, 1]
        for n in range(len(xy)):
            left, top = min(left, xy[n, 0]), min(top, xy[n, 1])
        for n in range(len(xy)):
            column[n] = int(min((xy[n, 0] - left) / _REACH_PX, _MOST_CELLS - 1))
            row[n] = int(min((xy[n, 1] - top) / _REACH_PX, _MOST_CELLS - 1))
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
