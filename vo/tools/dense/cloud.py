"""A cloud of points: weighted means of all depths in cubes of space."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.rectification import RectifiedRig
from vo.base.types import Bytes, Floats, Floats32, Ints

_BITS = 21  # of each coordinate of a cube in its key
_OFFSET = 1 << (_BITS - 1)
_MERGE_ROWS = 2_000_000  # of cubes that wait to be merged
_MIN_COSINE = 0.1  # of the steepest view of a surface that is used
_WEIGHT, _XYZ, _NORMAL, _RGB, _COUNT, _VIEWS = 0, slice(1, 4), slice(4, 7), slice(7, 10), 10, 11
_SUMS = 12  # columns of the sums of a cube


class Cloud(NamedTuple):
    """Points of surfaces.

    Attributes:
        xyz: (N, 3) positions in the world.
        normal: (N, 3) unit normals, towards the cameras.
        rgb: (N, 3) uint8.
        views: (N,) number of keyframes that see them.
    """

    xyz: Floats
    normal: Floats
    rgb: Bytes
    views: Ints


class CubeCloud:
    """Gathers points in cubes of an edge length."""

    def __init__(self, edge: float, rig: RectifiedRig) -> None:
        self._edge = edge
        self._camera = np.array([rig.fx, rig.fy, rig.cx, rig.cy])
        self._merged: list[tuple[Ints, Floats32]] = [_merge([])]
        self._waiting: list[tuple[Ints, Floats32]] = []

    def add(self, inverse: Floats32, sigma: Floats32, rgb: Bytes, world_from_cam: Floats) -> Ints:
        """Add the inverse depths (H, W) of a keyframe; returns the cubes (N, 3) that it sees."""
        view = np.ascontiguousarray(inverse), sigma, rgb, world_from_cam, self._camera
        keys, sums = _cubes_of(*view, self._edge)
        self._waiting.append((keys, sums.astype(np.float32)))
        if sum(len(each) for each, _ in self._waiting) > _MERGE_ROWS:
            self._merge()
        return cubes_of_keys(keys)

    def cloud(self) -> Cloud:
        """The points."""
        self._merge()
        keys, sums = self._merged[0]
        corner = cubes_of_keys(keys) * self._edge
        length = np.linalg.norm(sums[:, _NORMAL], axis=1, keepdims=True)
        return Cloud(
            corner + sums[:, _XYZ] / sums[:, [_WEIGHT]],
            sums[:, _NORMAL] / np.maximum(length, 1e-9),
            np.round(sums[:, _RGB] / sums[:, [_COUNT]]).astype(np.uint8),
            sums[:, _VIEWS].astype(np.int64),
        )

    def _merge(self) -> None:
        self._merged = [_merge([*self._merged, *self._waiting])]
        self._waiting = []


def keys_of_cubes(cubes: Ints) -> Ints:
    """Keys (N,) of cubes (N, 3), in the order of these; unique to 2**20 from the origin."""
    x, y, z = (cubes + _OFFSET).T
    return np.asarray(x << 2 * _BITS | y << _BITS | z)


def cubes_of_keys(keys: Ints) -> Ints:
    """Cubes (N, 3), counted from the origin, of keys (N,)."""
    cube = np.stack([keys >> 2 * _BITS, keys >> _BITS, keys], axis=1) & ((1 << _BITS) - 1)
    return np.asarray(cube - _OFFSET)


def _merge(parts: list[tuple[Ints, Floats32]]) -> tuple[Ints, Floats32]:
    """Increasing keys, and sums of the rows of each."""
    if not parts:
        return np.empty(0, np.int64), np.empty((0, _SUMS), np.float32)
    keys = np.concatenate([keys for keys, _ in parts])
    sums = np.concatenate([sums for _, sums in parts])
    if not len(keys):
        return keys, sums
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    first = np.flatnonzero(np.diff(keys, prepend=keys[0] - 1))
    return keys[first], np.add.reduceat(sums[order], first, axis=0)


@compiled
def _cubes_of(inverse, sigma, rgb, pose, camera, edge):  # type: ignore[no-untyped-def]
    """Keys (N,) of cubes that contain points, unique to 2**20 from the origin, and sums (N, 12).

    Positions are relative to the corner of the cube and weighted by 1 / variance of the depth,
    whose sigma is sigma / inverse**2. A normal is that of the triangle of neighbouring pixels;
    across the edge between a near and a far surface it is that of neither, and steep.
    """
    rows, columns = inverse.shape
    fx, fy, cx, cy = camera
    size = 1024
    while size < 2 * np.count_nonzero(inverse):
        size *= 2
    table = np.full(size, -1, np.int64)
    keys = np.empty(size // 2 + 1, np.int64)
    sums = np.zeros((size // 2 + 1, _SUMS))
    count = 0
    cube, p, n = np.zeros(3, np.int64), np.zeros(3), np.zeros(3)
    for v in range(1, rows - 1):
        for u in range(1, columns - 1):
            w = inverse[v, u]
            if w <= 0.0 or not _normal(inverse, v, u, camera, n):
                continue
            z = 1.0 / w
            x, y = (u - cx) / fx * z, (v - cy) / fy * z
            for a in range(3):
                p[a] = pose[a, 0] * x + pose[a, 1] * y + pose[a, 2] * z + pose[a, 3]
                cube[a] = int(np.floor(p[a] / edge))
            key = ((cube[0] + _OFFSET) << 2 * _BITS) | ((cube[1] + _OFFSET) << _BITS)
            key |= cube[2] + _OFFSET
            place = (key ^ (key >> 31)) * 0x9E3779B97F4A7C15 >> 20 & (size - 1)
            while table[place] >= 0 and keys[table[place]] != key:
                place = (place + 1) & (size - 1)
            if table[place] < 0:
                table[place] = count
                keys[count] = key
                sums[count, 11] = 1.0
                count += 1
            r = table[place]
            weight = (w * w / sigma[v, u]) ** 2
            sums[r, 0] += weight
            sums[r, 10] += 1.0
            for a in range(3):
                sums[r, 1 + a] += weight * (p[a] - cube[a] * edge)
                sums[r, 4 + a] += pose[a, 0] * n[0] + pose[a, 1] * n[1] + pose[a, 2] * n[2]
                sums[r, 7 + a] += rgb[v, u, a]
    return keys[:count], sums[:count]


@compiled
def _normal(inverse, v, u, camera, n):  # type: ignore[no-untyped-def]
    """Normal towards the camera at a pixel; False where it is steep or a neighbour is unknown."""
    fx, fy, cx, cy = camera
    left, right = inverse[v, u - 1], inverse[v, u + 1]
    above, below = inverse[v - 1, u], inverse[v + 1, u]
    if left <= 0.0 or right <= 0.0 or above <= 0.0 or below <= 0.0:
        return False
    x, y = (u - cx) / fx, (v - cy) / fy
    ax = (x + 1.0 / fx) / right - (x - 1.0 / fx) / left
    ay, az = y / right - y / left, 1.0 / right - 1.0 / left
    bx, by = x / below - x / above, (y + 1.0 / fy) / below - (y - 1.0 / fy) / above
    bz = 1.0 / below - 1.0 / above
    n[0], n[1], n[2] = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
    length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    if length <= 0.0:
        return False
    n /= length
    return n[0] * x + n[1] * y + n[2] < -_MIN_COSINE * np.sqrt(x * x + y * y + 1.0)
