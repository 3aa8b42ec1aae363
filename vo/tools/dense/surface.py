"""A mesh: signed distances to surfaces in blocks of space, and the surface where they are zero.

Distances are averaged as in Curless and Levoy, "A volumetric method for building complex models
from range images" (SIGGRAPH 1996), in blocks near surfaces only (Nießner et al., "Real-time 3D
reconstruction at scale using voxel hashing", 2013). The mesh has one vertex in each cell that the
surface passes (Gibson, "Constrained elastic surface nets", 1998).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import compiled
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse
from vo.base.types import Bytes, Floats, Floats32, Ints
from vo.recordings.formats.mesh import Mesh
from vo.tools.dense.cloud import cubes_of_keys, keys_of_cubes

Ints16 = NDArray[np.int16]

_REACH = 4  # voxels to both sides of a surface within which distances are kept
_SIDE = 2 * _REACH  # voxels of a block, along each axis
_STEPS = 8191.0 / _REACH  # of a distance of one voxel, as it is stored
_MAX_CHANGE = 4.0  # of the distance within a cell; more is the edge between two surfaces
_FIRST_BLOCKS = 1024
_MIN_VIEWS = 2  # keyframes that see a voxel of the mesh
_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


class DistanceField:
    """Signed distances on a grid of voxels with an edge length."""

    def __init__(self, edge: float, rig: RectifiedRig) -> None:
        self._edge = edge
        self._camera = np.array([rig.fx, rig.fy, rig.cx, rig.cy])
        self._rows: dict[int, int] = {}  # by the key of a block
        self._distance = np.zeros((_FIRST_BLOCKS, _SIDE, _SIDE, _SIDE), np.int16)
        self._views = np.zeros(self._distance.shape, np.uint8)
        self._rgb = np.zeros((*self._distance.shape, 3), np.uint8)

    def add(self, depth: Floats32, rgb: Bytes, world_from_cam: Floats, cubes: Ints) -> None:
        """Add the inverse depths (H, W) of a keyframe, which are in the voxels `cubes` (N, 3)."""
        keys = _near(cubes)
        known = self._rows
        rows = np.array([known.setdefault(key, len(known)) for key in keys.tolist()], np.int64)
        while len(known) > len(self._distance):
            for name in ("_distance", "_views", "_rgb"):
                values = getattr(self, name)
                setattr(self, name, np.concatenate([values, np.zeros_like(values)]))
        if len(rows):
            fields = self._distance, self._views, self._rgb
            view = np.ascontiguousarray(depth), rgb, inverse(world_from_cam), self._camera
            _integrate(*fields, rows, cubes_of_keys(keys), self._edge, *view)

    def mesh(self) -> Mesh:
        """The surface."""
        keys = np.array(sorted(self._rows), np.int64)
        rows = np.array([self._rows[key] for key in keys.tolist()], np.int64)
        blocks = cubes_of_keys(keys)
        near = np.full((len(keys), 8), -1, np.int64)
        for c, corner in enumerate(_CORNERS if len(keys) else ()):
            wanted = keys_of_cubes(blocks + corner)
            at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            near[:, c] = np.where(keys[at] == wanted, rows[at], -1)
        cell, position, rgb, signs = _crossed_cells(
            self._distance, self._views, self._rgb, near, blocks
        )
        return Mesh(position * self._edge, _faces(cell, signs), rgb)


def _near(cubes: Ints) -> Ints:
    """Increasing keys (B,) of the blocks within reach of voxels (N, 3)."""
    halves = cubes_of_keys(np.unique(keys_of_cubes(cubes // _REACH)))
    low, high = (halves - 1) // 2, (halves + 1) // 2
    ends = [keys_of_cubes(np.where(corner, high, low)) for corner in _CORNERS]
    return np.unique(np.concatenate(ends))


@compiled
def _integrate(distance, views, colour, rows, blocks, edge, depth, rgb, cam_from_world, camera):  # type: ignore[no-untyped-def]
    """Distances along the axis of the camera, in voxels, truncated at the reach."""
    height, width = depth.shape
    fx, fy, cx, cy = camera
    m = cam_from_world
    for n in range(len(rows)):
        r = rows[n]
        for i in range(_SIDE):
            for j in range(_SIDE):
                for k in range(_SIDE):
                    x = (blocks[n, 0] * _SIDE + i) * edge
                    y = (blocks[n, 1] * _SIDE + j) * edge
                    z = (blocks[n, 2] * _SIDE + k) * edge
                    zc = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
                    if zc <= edge:
                        continue
                    u = fx * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / zc + cx
                    v = fy * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / zc + cy
                    a, b = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
                    if a < 0 or b < 0 or a >= height or b >= width or depth[a, b] <= 0.0:
                        continue
                    d = (1.0 / depth[a, b] - zc) / edge
                    if abs(d) > _REACH:
                        continue
                    n_views = views[r, i, j, k]
                    share = 1.0 / (n_views + 1.0)
                    old = float(distance[r, i, j, k])
                    distance[r, i, j, k] = round(old + (d * _STEPS - old) * share)
                    for c in range(3):
                        shade = float(colour[r, i, j, k, c])
                        colour[r, i, j, k, c] = round(shade + (rgb[a, b, c] - shade) * share)
                    views[r, i, j, k] = min(n_views + 1, 255)


@compiled
def _corner_values(distance, views, near, values):  # type: ignore[no-untyped-def]
    """Values (9, 9, 9) of a block and its neighbours in positive directions, NaN where unknown."""
    for i in range(_SIDE + 1):
        for j in range(_SIDE + 1):
            for k in range(_SIDE + 1):
                r = near[4 * (i // _SIDE) + 2 * (j // _SIDE) + k // _SIDE]
                at = i % _SIDE, j % _SIDE, k % _SIDE
                known = r >= 0 and views[r, at[0], at[1], at[2]] >= _MIN_VIEWS
                values[i, j, k] = distance[r, at[0], at[1], at[2]] / _STEPS if known else np.nan


@compiled
def _count_or_fill(distance, views, colour, near, blocks, cell, position, rgb, signs):  # type: ignore[no-untyped-def]
    """Cells that the surface passes; only their number where `cell` is empty."""
    values = np.empty((_SIDE + 1, _SIDE + 1, _SIDE + 1), np.float32)
    count = 0
    at = np.zeros(3)
    for n in range(len(near)):
        _corner_values(distance, views, near[n], values)
        for i in range(_SIDE):
            for j in range(_SIDE):
                for k in range(_SIDE):
                    low, high, known = np.inf, -np.inf, True
                    for c in range(8):
                        d = values[i + (c >> 2), j + ((c >> 1) & 1), k + (c & 1)]
                        known = known and not np.isnan(d)
                        low, high = min(low, d), max(high, d)
                    if not known or low >= 0.0 or high < 0.0 or high - low > _MAX_CHANGE:
                        continue
                    if len(cell):
                        _vertex(values, i, j, k, at)
                        cell[count, 0] = blocks[n, 0] * _SIDE + i
                        cell[count, 1] = blocks[n, 1] * _SIDE + j
                        cell[count, 2] = blocks[n, 2] * _SIDE + k
                        for c in range(3):
                            position[count, c] = cell[count, c] + at[c]
                            rgb[count, c] = colour[near[n, 0], i, j, k, c]
                        first = values[i, j, k] < 0.0
                        for c in range(3):
                            d = values[i + (c == 0), j + (c == 1), k + (c == 2)] < 0.0
                            signs[count, c] = 0 if d == first else 1 if first else -1
                    count += 1
    return count


@compiled
def _vertex(values, i, j, k, at):  # type: ignore[no-untyped-def]
    """Mean of the points where the edges of a cell cross the surface."""
    at[:] = 0.0
    crossings = 0
    for c in range(8):
        for axis in range(3):
            bit = 4 >> axis
            if c & bit:
                continue
            e = c | bit
            p = values[i + (c >> 2), j + ((c >> 1) & 1), k + (c & 1)]
            q = values[i + (e >> 2), j + ((e >> 1) & 1), k + (e & 1)]
            if (p < 0.0) == (q < 0.0):
                continue
            s = p / (p - q)
            at[0] += (c >> 2) + (s if axis == 0 else 0.0)
            at[1] += ((c >> 1) & 1) + (s if axis == 1 else 0.0)
            at[2] += (c & 1) + (s if axis == 2 else 0.0)
            crossings += 1
    for axis in range(3):
        at[axis] /= crossings


def _crossed_cells(
    distance: Ints16, views: Bytes, colour: Bytes, near: Ints, blocks: Ints
) -> tuple[Ints, Floats, Bytes, Ints]:
    """Cells (C, 3), their vertices (C, 3) and colours, and signs (C, 3) along the edges from them.

    A sign is 1 where the surface is left along the positive axis, -1 where it is entered, else 0.
    """
    fields = distance, views, colour, near, blocks

    def outputs(count: int) -> tuple[Ints, Floats, Bytes, Ints]:
        rows = (count, 3)
        return (
            np.zeros(rows, np.int64),
            np.zeros(rows),
            np.zeros(rows, np.uint8),
            np.zeros(rows, np.int64),
        )

    found = outputs(_count_or_fill(*fields, *outputs(0)))
    if len(found[0]):
        _count_or_fill(*fields, *found)
    return found


def _faces(cell: Ints, signs: Ints) -> Ints:
    """Triangles (T, 3): two for each edge of the grid that crosses the surface, between 4 cells."""
    if not len(cell):
        return np.empty((0, 3), np.int64)
    low = cell.min(axis=0) - 1
    span = cell.max(axis=0) - low + 2
    keys = ((cell - low) @ np.array([span[1] * span[2], span[2], 1])).astype(np.int64)
    order = np.argsort(keys, kind="stable")
    in_order = keys[order]
    step = np.array([span[1] * span[2], span[2], 1])
    triangles = []
    for axis in range(3):
        b, c = step[(axis + 1) % 3], step[(axis + 2) % 3]
        rows = np.flatnonzero(signs[:, axis])
        corners = np.stack([keys[rows] - offset for offset in (0, b, b + c, c)], axis=1)
        at = np.minimum(np.searchsorted(in_order, corners), len(keys) - 1)
        whole = (in_order[at] == corners).all(axis=1)
        quad = order[at][whole]
        back = signs[rows[whole], axis] < 0
        quad[back] = quad[back][:, ::-1]
        triangles += [quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]
    return np.concatenate(triangles)
