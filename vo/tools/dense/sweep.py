"""Depth of one camera's keyframes, by a plane sweep over neighbouring ones.

Planes parallel to the image, at equal steps of inverse depth, carry the neighbours' images into
that of the keyframe (Collins, "A space-sweep approach to true multi-image matching", CVPR 1996).
Their correlations are smoothed as in semi-global matching.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse
from vo.base.types import Bools, Bytes, Floats, Floats32
from vo.tools.dense.depth import MAX_ERROR, DepthMap

_SHRINK = 2  # images are matched at this part of their size
_RANGE = 0.2  # of the image's width, the largest displacement by the median neighbour
_MAX_PLANES = 192
_WINDOW_PX = 5  # of the correlation
_MIN_VARIANCE = 4.0  # grey levels squared, below which there is no texture
_COSTS = 64  # of the worst correlation
_SMALL_STEP, _LARGE_STEP = 5, 40  # costs of a change by one plane, and of any other
_UNIQUE = 1.05  # least ratio of the second smallest sum of costs to the smallest
_SIGMA_PLANES = 0.25  # of a depth, in distances of planes
_SPECKLE_PX = 60
_SUBPLANES = 16


Seen = tuple[Bytes, Floats]
"""A grey image (H, W), and the pose (4, 4) of its camera in the world."""


def swept_depth(
    seen: Seen, earlier: Sequence[Seen], later: Sequence[Seen], rig: RectifiedRig
) -> DepthMap:
    """Depth of an image, from neighbours before and after it.

    What hides a surface from those on one side seldom hides it from the others, so that the better
    side counts. Unknown everywhere if the camera has not moved.
    """
    image, world_from_cam = seen
    sides = [
        [(_shrunk(other), inverse(pose) @ world_from_cam) for other, pose in side]
        for side in (earlier, later)
    ]
    lengths = [float(np.linalg.norm(move[:3, 3])) for side in sides for _, move in side]
    if not lengths or max(lengths) <= 0.0 or np.median(lengths) <= 0.0:
        return DepthMap(np.zeros(image.shape, np.float32), 1.0)
    step = _SHRINK / (rig.fx * max(lengths))
    nearest = _RANGE * rig.width / (rig.fx * float(np.median(lengths)))
    planes = min(int(np.ceil(nearest / step)), _MAX_PLANES)
    correlation = _Correlation(_shrunk(image), rig.matrix)
    costs = np.full((planes, *correlation.shape), _COSTS, np.uint8)
    for k in range(planes):
        for side in filter(None, sides):
            total = sum(correlation.by_plane(*each, (k + 0.5) * step) for each in side)
            cost = (1.0 - total / len(side)) * (_COSTS / 2)
            costs[k] = np.minimum(costs[k], np.clip(cost, 0, _COSTS).astype(np.uint8))
    found = _depth(costs, correlation.has_texture, step, image)
    centres = [-move[:3, :3].T @ move[:3, 3] for side in sides for _, move in side]
    sigma = _SIGMA_PLANES * _SHRINK / np.maximum(_parallax(centres, rig), 1e-9)
    reliable = found * np.float32(MAX_ERROR) > sigma
    return DepthMap(np.where(reliable, found, np.float32(0)), _SIGMA_PLANES * step)


def _parallax(centres: Sequence[Floats], rig: RectifiedRig) -> Floats32:
    """Largest displacement (H, W) in pixels by the translation to a neighbour, at unit depth.

    `centres`: (3,) of the neighbours in the camera. It vanishes towards them, where a camera that
    moves ahead sees nothing of depth.
    """
    x = ((np.arange(rig.width) - rig.cx) / rig.fx).astype(np.float32)[None]
    y = ((np.arange(rig.height) - rig.cy) / rig.fy).astype(np.float32)[:, None]
    found = [np.hypot(c[0] - c[2] * x, c[1] - c[2] * y) for c in centres]
    return np.asarray(rig.fx * np.maximum.reduce(found), dtype=np.float32)


def _depth(costs: Bytes, has_texture: Bools, step: float, image: Bytes) -> Floats32:
    by_pixel = np.ascontiguousarray(costs.transpose(1, 2, 0))
    total = np.zeros(by_pixel.shape, np.uint16)
    for along_rows in (True, False):
        for forward in (True, False):
            _add_costs(by_pixel, total, along_rows, forward)
    found = _least(total, has_texture)
    cv2.filterSpeckles(found, 0, _SPECKLE_PX, 2 * _SUBPLANES)
    inverse_depth = np.maximum(found, 0).astype(np.float32) * np.float32(step / _SUBPLANES)
    size = image.shape[1], image.shape[0]
    full = cv2.resize(inverse_depth, size, interpolation=cv2.INTER_NEAREST)
    return np.asarray(full, dtype=np.float32)


def _shrunk(image: Bytes) -> Bytes:
    size = image.shape[1] // _SHRINK, image.shape[0] // _SHRINK
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


class _Correlation:
    """Normalised correlation of windows of an image with those of another one."""

    def __init__(self, image: Bytes, matrix: Floats) -> None:
        self.shape = image.shape
        self._image = image.astype(np.float32)
        self._mean = _mean(self._image)
        self._variance = _mean(self._image * self._image) - self._mean * self._mean
        self.has_texture = self._variance > _MIN_VARIANCE
        self._matrix = matrix.copy()
        self._matrix[:2] /= _SHRINK
        self._matrix[:2, 2] -= 0.5 * (1.0 - 1.0 / _SHRINK)

    def by_plane(self, other: Bytes, move: Floats, inverse_depth: float) -> Floats32:
        """Correlations (H, W), -1 to 1, with an image that a plane carries over.

        `move`: (4, 4) other_from_cam. The plane z = 1 / w of the camera induces the homography
        K (R + t (0 0 w)) K^-1 (Hartley and Zisserman, Multiple View Geometry, 13.1).
        """
        plane = move[:3, :3].copy()
        plane[:, 2] += move[:3, 3] * inverse_depth
        homography = self._matrix @ plane @ np.linalg.inv(self._matrix)
        size, flags = self.shape[::-1], cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpPerspective(other, homography, size, flags=flags).astype(np.float32)
        mean = _mean(warped)
        variance = _mean(warped * warped) - mean * mean
        covariance = _mean(warped * self._image) - mean * self._mean
        scale = np.sqrt(np.maximum(variance * self._variance, np.float32(_MIN_VARIANCE**2)))
        return np.asarray(covariance / scale, dtype=np.float32)


def _mean(values: Floats32) -> Floats32:
    return np.asarray(cv2.boxFilter(values, -1, (_WINDOW_PX, _WINDOW_PX)), dtype=np.float32)


@compiled
def _add_costs(costs, total, along_rows, forward):  # type: ignore[no-untyped-def]
    """Add the costs (H, W, K) of paths in one direction: equation 13 of Hirschmüller's paper."""
    rows, columns, planes = costs.shape
    outer, inner = (rows, columns) if along_rows else (columns, rows)
    before, now = np.zeros(planes, np.int32), np.zeros(planes, np.int32)
    for a in range(outer):
        before[:] = 0
        smallest = 0
        for b in range(inner):
            c = b if forward else inner - 1 - b
            i, j = (a, c) if along_rows else (c, a)
            new_smallest = 1 << 30
            for k in range(planes):
                best = min(before[k], smallest + _LARGE_STEP)
                if k > 0:
                    best = min(best, before[k - 1] + _SMALL_STEP)
                if k + 1 < planes:
                    best = min(best, before[k + 1] + _SMALL_STEP)
                now[k] = costs[i, j, k] + best - smallest
                new_smallest = min(new_smallest, now[k])
                total[i, j, k] += now[k]
            smallest = new_smallest
            before, now = now, before


@compiled
def _least(total, has_texture):  # type: ignore[no-untyped-def]
    """Plane (H, W) with the least sum of costs, in parts of a plane; 0 where it is not unique."""
    rows, columns, planes = total.shape
    found = np.zeros((rows, columns), np.int16)
    for i in range(rows):
        for j in range(columns):
            if not has_texture[i, j]:
                continue
            best = 0
            for k in range(planes):
                if total[i, j, k] < total[i, j, best]:
                    best = k
            second = np.inf
            for k in range(planes):
                if abs(k - best) > 1:
                    second = min(second, float(total[i, j, k]))
            least = float(total[i, j, best])
            if best == 0 or best == planes - 1 or second < _UNIQUE * least:
                continue
            a, c = float(total[i, j, best - 1]), float(total[i, j, best + 1])
            curve = a - 2.0 * least + c
            offset = 0.5 * (a - c) / curve if curve > 0 else 0.0
            found[i, j] = int(np.floor(_SUBPLANES * (best + 0.5 + offset) + 0.5))
    return found
