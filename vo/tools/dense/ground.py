"""The ground: its plane, and which of its cells are free, for the navigation of robots."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.transforms import make_transform
from vo.base.types import Bytes, Floats, Ints
from vo.tools.dense.cloud import Cloud

_MAX_TILT_COS = 0.9  # of the ground against the direction that is taken for up
_BINS_PER_EDGE = 0.5  # of heights, per edge of a cube of the cloud
_LOWEST_SHARE = 0.3  # least share of the largest floor that a lower floor has
_ROUNDS, _MAX_EDGES = 5, 3.0  # of the fit of a plane, and distance of its points in edges
_HIT, _FREE, _LIMIT, _DECIDED = 0.85, -0.4, 4.0, 0.5  # log odds
OCCUPIED, FREE, UNKNOWN = 0, 254, 205  # grey levels of ROS' map server


class Ground(NamedTuple):
    """The ground as a plane z = 0, with z up; x is ahead of the first camera, below which it is."""

    ground_from_world: Floats
    is_found: bool  # False: too few points, the plane lies where the lowest ones are


class Grid(NamedTuple):
    """What lies in the cells of the ground.

    Attributes:
        cells: (R, C) uint8, the first row has the largest y.
        edge: length of a cell.
        origin: x and y of the lower left corner.
    """

    cells: Bytes
    edge: float
    origin: tuple[float, float]


def find_ground(cloud: Cloud, up: Floats, world_from_cam: Floats, edge: float) -> Ground:
    """The largest floor, or a lower one nearly as large.

    `up`: (3,) unit vector in the world, roughly or exactly up. `world_from_cam`: (K, 4, 4).
    """
    flat = cloud.xyz[cloud.normal @ up > _MAX_TILT_COS]
    height = flat @ up
    camera_height = world_from_cam[:, :3, 3] @ up
    flat = flat[height < np.median(camera_height)]
    normal, offset, is_found = (
        up,
        float(min(camera_height.min(), (cloud.xyz @ up).min(initial=0))),
        False,
    )
    if len(flat) >= 100:
        bin_edges = np.arange(
            (flat @ up).min(), (flat @ up).max() + 4 * edge, edge / _BINS_PER_EDGE
        )
        counts, bins = np.histogram(flat @ up, bin_edges)
        lowest = int(np.flatnonzero(counts >= _LOWEST_SHARE * counts.max())[0])
        offset, is_found = float(0.5 * (bins[lowest] + bins[lowest + 1])), True
        for _ in range(_ROUNDS):
            near = flat[np.abs(flat @ normal - offset) < _MAX_EDGES * edge]
            if len(near) < 100:
                break
            middle = near.mean(axis=0)
            direction = np.linalg.svd(near - middle, full_matrices=False)[2][2]
            normal = direction * np.sign(direction @ up)
            offset = float(middle @ normal)
    first = world_from_cam[0]
    ahead = first[:3, 2] - (first[:3, 2] @ normal) * normal
    if np.linalg.norm(ahead) < 0.1:  # the camera looks down: the top of its image is ahead
        ahead = -first[:3, 1] + (first[:3, 1] @ normal) * normal
    x = ahead / np.linalg.norm(ahead)
    rotation = np.stack([x, np.cross(normal, x), normal])
    foot = first[:3, 3] - (first[:3, 3] @ normal - offset) * normal
    return Ground(make_transform(rotation, -rotation @ foot), is_found)


class OccupancyGrid:
    """Gathers what keyframes see in a grid on the ground.

    Args:
        low, high: corners (2,) of the area on the ground.
        edge: length of a cell.
        band: heights above the ground between which something is an obstacle.
    """

    def __init__(self, low: Floats, high: Floats, edge: float, band: tuple[float, float]) -> None:
        self._low = np.floor(low / edge) * edge
        shape = np.ceil((high - self._low) / edge).astype(int) + 1
        self._odds = np.zeros((int(shape[0]), int(shape[1])), np.float32)  # by x and y
        self._edge, self._band = edge, band

    def add(self, points: Floats, columns: Ints, ground_from_cam: Floats) -> None:
        """Add points (N, 3) over the ground that a keyframe sees in columns (N,) of its image."""
        camera = (ground_from_cam[:2, 3] - self._low) / self._edge
        xy = (points[:, :2] - self._low) / self._edge
        obstacle = (points[:, 2] >= self._band[0]) & (points[:, 2] <= self._band[1])
        overhead = points[:, 2] > self._band[1]
        kept = ~overhead
        _add_scan(self._odds, camera, xy[kept], obstacle[kept], columns[kept].astype(np.int64))

    def grid(self) -> Grid:
        """The cells as they are known now."""
        cells = np.full(self._odds.shape, UNKNOWN, np.uint8)
        cells[self._odds > _DECIDED] = OCCUPIED
        cells[self._odds < -_DECIDED] = FREE
        origin = float(self._low[0]), float(self._low[1])
        return Grid(np.ascontiguousarray(cells.T[::-1]), self._edge, origin)


@compiled
def _add_scan(odds, camera, xy, obstacle, column):  # type: ignore[no-untyped-def]
    """A column of an image is a ray over the ground.

    It is free as far as its nearest obstacle, or else the farthest point of the ground.
    """
    count = column.max() + 1 if len(column) else 0
    nearest = np.full(count, np.inf)
    farthest = np.zeros(count)
    end = np.zeros((count, 2))
    for n in range(len(column)):
        c = column[n]
        dx, dy = xy[n, 0] - camera[0], xy[n, 1] - camera[1]
        distance = np.sqrt(dx * dx + dy * dy)
        if obstacle[n]:
            nearest[c] = min(nearest[c], distance)
        if distance > farthest[c]:
            farthest[c] = distance
            end[c, 0], end[c, 1] = dx / distance, dy / distance
    changed = np.zeros(odds.shape, np.int8)
    for c in range(count):
        reach = min(farthest[c], nearest[c] - 1.0)
        steps = int(np.floor(2.0 * reach))
        for s in range(steps):
            i = int(np.floor(camera[0] + 0.5 * s * end[c, 0]))
            j = int(np.floor(camera[1] + 0.5 * s * end[c, 1]))
            if i >= 0 and j >= 0 and i < odds.shape[0] and j < odds.shape[1]:
                changed[i, j] = 1
    for n in range(len(column)):
        if obstacle[n]:
            i, j = int(np.floor(xy[n, 0])), int(np.floor(xy[n, 1]))
            if i >= 0 and j >= 0 and i < odds.shape[0] and j < odds.shape[1]:
                changed[i, j] = 2
    for i in range(odds.shape[0]):
        for j in range(odds.shape[1]):
            if changed[i, j]:
                step = _FREE if changed[i, j] == 1 else _HIT
                odds[i, j] = min(max(odds[i, j] + step, -_LIMIT), _LIMIT)
