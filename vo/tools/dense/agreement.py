"""Which depths of a keyframe other keyframes confirm, and the mean of both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import inverse
from vo.base.types import Bytes, Floats, Floats32
from vo.tools.dense.depth import DepthMap

_MAX_SIGMAS = 2.0  # between depths of one surface


def confirmed(
    depth: DepthMap,
    world_from_cam: Floats,
    others: Sequence[tuple[DepthMap, Floats]],
    camera: Intrinsics,
    min_views: int,
) -> tuple[Floats32, Bytes]:
    """Inverse depths (H, W) that other keyframes confirm, weighted means with theirs; else 0.

    And 1 where two or more others look through what is seen, and none sees it, else 0.

    A depth is confirmed if at least `min_views` others see the surface where it says, and more of
    them than look through it, as they do where something has moved.
    """
    if not others:
        return np.zeros_like(depth.inverse), np.zeros(depth.inverse.shape, np.uint8)
    maps = np.stack([each.inverse for each, _ in others])
    sigmas = np.stack([each.sigma for each, _ in others])
    moves = np.stack([inverse(pose) @ world_from_cam for _, pose in others])
    own = np.ascontiguousarray(depth.inverse), depth.sigma
    found, contradicted = _confirmed(
        *own, maps, sigmas, moves, np.array(camera, np.float64), min_views
    )
    return np.asarray(found, dtype=np.float32), np.asarray(contradicted, dtype=np.uint8)


@compiled
def _confirmed(inverse, sigma, maps, sigmas, moves, camera, min_views):  # type: ignore[no-untyped-def]
    """`moves` (N, 4, 4): other_from_cam.

    Along a ray r of the camera the other's depth is a / w + b for inverse depth w, a = (R r)_z and
    b = t_z, so that a depth z of the other gives w = a / (z - b).
    """
    rows, columns = inverse.shape
    fx, fy, cx, cy = camera
    result, contradicted = np.zeros_like(inverse), np.zeros(inverse.shape, np.uint8)
    for v in range(rows):
        for u in range(columns):
            w = inverse[v, u]
            if w <= 0.0:
                continue
            x, y = (u - cx) / fx, (v - cy) / fy
            own = sigma[v, u]
            weight, total, agree, against = 1.0 / own**2, w / own**2, 0, 0
            for k in range(len(maps)):
                m = moves[k]
                a = m[2, 0] * x + m[2, 1] * y + m[2, 2]
                z = a / w + m[2, 3]
                if z <= 0.0:
                    continue
                px = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w + m[0, 3]
                py = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w + m[1, 3]
                i, j = int(np.floor(fy * py / z + cy + 0.5)), int(np.floor(fx * px / z + cx + 0.5))
                if i < 0 or j < 0 or i >= rows or j >= columns:
                    continue
                seen = maps[k, i, j]
                if seen <= 0.0:
                    continue
                # Sigma of 1 / z as this camera predicts it: d(1/z) = a / (w z)^2 dw.
                predicted = a / (w * z) ** 2 * own
                limit = _MAX_SIGMAS * np.sqrt(predicted**2 + sigmas[k, i, j] ** 2)
                difference = seen - 1.0 / z
                if difference < -limit:
                    against += 1
                elif difference <= limit:
                    agree += 1
                    depth = 1.0 / seen - m[2, 3]
                    if a > 0.0 and depth > 0.0:
                        other = a / depth
                        s = sigmas[k, i, j] * other**2 / (a * seen**2)
                        weight += 1.0 / s**2
                        total += other / s**2
            if agree >= min_views and agree > against:
                result[v, u] = total / weight
            elif against >= 2 and agree == 0:
                contradicted[v, u] = 1
    return result, contradicted
