"""Depth of one camera's keyframes, by a plane sweep over neighbouring ones.

Planes parallel to the image carry the neighbours' images into
that of the keyframe (Collins, "A space-sweep approach to true multi-image matching", CVPR 1996).
Their correlations are smoothed as in semi-global matching.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse
from vo.base.types import Bools, Bytes, Floats, Floats32
from vo.tools.dense.depth import MAX_ERROR, DepthMap, even_depth

REACH = 3  # neighbours on each side
_SHRINK = 2  # images are matched at this part of their size
_RANGE = 0.4  # of the image's width, the largest displacement by the nearest neighbour
_MAX_STEP = 0.03  # of inverse depth from plane to plane, beyond which there is no use in more
_MAX_PLANES = 400
_MAX_MOTION = 0.35  # of the depth: a longer way changes the scale of what is seen too much
_MIN_SHARE = 0.1  # of the longest way to a neighbour: those that are nearer show no depth
_WINDOW_PX = 5  # of the correlation
_MIN_VARIANCE = 1.0  # grey levels squared, below which there is no texture
_COSTS = 64  # of the worst correlation
_SMALL_STEP, _LARGE_STEP = 5, 40  # costs of a change by one plane, and of any other
_SIGMA_PLANES = 0.2  # of a depth, in distances of planes
_SPECKLE_PX = 60
_SUBPLANES = 16
_MAX_BEND = 0.05  # of inverse depth among neighbouring pixels of one surface


Seen = tuple[Bytes, Floats]
"""A grey image (H, W), and the pose (4, 4) of its camera in the world."""


class _Neighbour(NamedTuple):
    """An image (H, W) of its part, other_from_cam (4, 4), and the length of the way between."""

    image: Bytes
    move: Floats
    length: float


def swept_depth(
    seen: Seen, earlier: Sequence[Seen], later: Sequence[Seen], rig: RectifiedRig
) -> DepthMap:
    """Depth of an image, from neighbours before and after it.

    For each plane one neighbour on each side is compared: the farthest that does not see what is
    there at another scale. What hides a surface from those on one side seldom hides it from the
    others, so that the better side counts. Unknown everywhere if the camera has not moved.
    """
    image, world_from_cam = seen
    sides = [
        [_neighbour(other, inverse(pose) @ world_from_cam) for other, pose in side]
        for side in (earlier, later)
    ]
    longest = max((each.length for side in sides for each in side), default=0.0)
    if longest <= 0.0:
        return even_depth(np.zeros(image.shape, np.float32), 1.0)
    sides = [[each for each in side if each.length >= _MIN_SHARE * longest] for side in sides]
    sides = [sorted(side, key=lambda each: each.length) for side in sides if side]
    shortest = min(side[0].length for side in sides)
    step = _SHRINK / (rig.fx * longest)
    planes = _planes(step, _RANGE * rig.width / (rig.fx * shortest))
    correlation = _Correlation(_shrunk(image), rig.matrix)
    costs = np.full((len(planes), *correlation.shape), _COSTS, np.uint8)
    used = [[_suited(side, plane) for side in sides] for plane in planes]
    for k, plane in enumerate(planes):
        found = [
            correlation.by_plane(side[n], plane) for side, n in zip(sides, used[k], strict=True)
        ]
        cost = (1.0 - np.maximum.reduce(found)) * (_COSTS / 2)
        costs[k] = np.clip(cost, 0, _COSTS).astype(np.uint8)
    at = _places(costs, correlation.has_texture)
    sigma = np.full(at.shape, _SIGMA_PLANES * step, np.float32)
    place = np.rint(at).astype(np.int64)
    for numbers in sorted({tuple(each) for each in used}):
        moves = [side[n].move for side, n in zip(sides, numbers, strict=True)]
        parallax = _parallax([-move[:3, :3].T @ move[:3, 3] for move in moves], rig, at.shape)
        here = np.array([tuple(each) == numbers for each in used])[place]
        sigma[here] = (_SIGMA_PLANES * _SHRINK / np.maximum(parallax, 1e-9))[here]
    return _at_full_size(at, planes, sigma, (image.shape[1], image.shape[0]))


def _neighbour(image: Bytes, move: Floats) -> _Neighbour:
    return _Neighbour(_shrunk(image), move, float(np.linalg.norm(move[:3, 3])))


def _planes(step: float, nearest: float) -> Floats:
    """Inverse depths, in equal steps as long as these are no smaller part of them than need be."""
    planes = [0.5 * step]
    while planes[-1] < nearest and len(planes) < _MAX_PLANES:
        planes.append(planes[-1] + max(step, _MAX_STEP * planes[-1]))
    return np.array(planes)


def _suited(side: Sequence[_Neighbour], inverse_depth: float) -> int:
    """Number of the farthest neighbour to which the way is short at this depth, or the nearest."""
    return max(
        (n for n, e in enumerate(side) if e.length * inverse_depth <= _MAX_MOTION), default=0
    )


def _at_full_size(at: Floats32, planes: Floats, sigma: Floats32, size: tuple[int, int]) -> DepthMap:
    """Inverse depths and their errors at places among the planes, as far as these tell depth."""
    inverse_depth = np.where(at > 0, np.interp(at, np.arange(len(planes)), planes), 0)
    inverse_depth = inverse_depth.astype(np.float32)
    sigma = np.maximum(sigma, np.float32(_SIGMA_PLANES * _MAX_STEP) * inverse_depth)
    inverse_depth[inverse_depth * np.float32(MAX_ERROR) < sigma] = 0
    near, far = (
        change(inverse_depth, np.ones((3, 3), np.uint8)) for change in (cv2.dilate, cv2.erode)
    )
    is_smooth = (far > 0) & (near - far < _MAX_BEND * near)
    nearest, smooth, errors = (
        np.asarray(cv2.resize(each, size, interpolation=cv2.INTER_NEAREST), each.dtype)
        for each in (inverse_depth, is_smooth.astype(np.uint8), sigma)
    )
    between = cv2.resize(inverse_depth, size, interpolation=cv2.INTER_LINEAR)
    full = np.where(smooth > 0, between, nearest).astype(np.float32)
    return DepthMap(full, errors.astype(np.float32))


def _parallax(centres: Sequence[Floats], rig: RectifiedRig, shape: tuple[int, ...]) -> Floats32:
    """Largest displacement in pixels by the translation to a neighbour, at unit depth.

    `centres`: (3,) of the neighbours in the camera. It vanishes towards them, where a camera that
    moves ahead sees nothing of depth. `shape`: rows and columns, each of which stands for some.
    """
    x = ((_SHRINK * np.arange(shape[1]) - rig.cx) / rig.fx).astype(np.float32)[None]
    y = ((_SHRINK * np.arange(shape[0]) - rig.cy) / rig.fy).astype(np.float32)[:, None]
    found = [np.hypot(c[0] - c[2] * x, c[1] - c[2] * y) for c in centres]
    return np.asarray(rig.fx * np.maximum.reduce(found), dtype=np.float32)


def _places(costs: Bytes, has_texture: Bools) -> Floats32:
    """Places (H, W) among the planes, 0 where unknown."""
    by_pixel = np.ascontiguousarray(costs.transpose(1, 2, 0))
    total = np.zeros(by_pixel.shape, np.uint16)
    for along_rows in (True, False):
        for forward in (True, False):
            _add_costs(by_pixel, total, along_rows, forward)
    found = _least(total, has_texture)
    cv2.filterSpeckles(found, 0, _SPECKLE_PX, 2 * _SUBPLANES)
    return np.asarray(np.maximum(found, 0) * np.float32(1.0 / _SUBPLANES), dtype=np.float32)


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

    def by_plane(self, other: _Neighbour, inverse_depth: float) -> Floats32:
        """Correlations (H, W), -1 to 1, with an image that a plane carries over.

        The plane z = 1 / w of the camera induces the homography
        K (R + t (0 0 w)) K^-1 (Hartley and Zisserman, Multiple View Geometry, 13.1).
        """
        plane = other.move[:3, :3].copy()
        plane[:, 2] += other.move[:3, 3] * inverse_depth
        homography = self._matrix @ plane @ np.linalg.inv(self._matrix)
        size, flags = self.shape[::-1], cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpPerspective(other.image, homography, size, flags=flags).astype(np.float32)
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
    """Plane (H, W) with the least sum of costs, in parts of a plane; 0 at the ends."""
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
            least = float(total[i, j, best])
            if best == 0 or best == planes - 1:
                continue
            a, c = float(total[i, j, best - 1]), float(total[i, j, best + 1])
            curve = a - 2.0 * least + c
            offset = 0.5 * (a - c) / curve if curve > 0 else 0.0
            found[i, j] = int(np.floor(_SUBPLANES * (best + offset) + 0.5))
    return found
