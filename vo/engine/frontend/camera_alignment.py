"""Camera motion by joint alignment of the patches of many points (sparse image alignment)."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.geometry.projection import (
    MIN_DEPTH,
    Intrinsics,
    by_cam_from_world,
    pixel,
    to_camera,
)
from vo.base.geometry.transforms import orthonormalised
from vo.base.types import Bytes, Floats
from vo.engine.frontend.patch_kernels import (
    LANES,
    blend_rows,
    compare,
    cut,
    make_template,
    workspace,
)
from vo.engine.geometry.pnp import take_step

_LEVELS = 3  # images of 1/2, 1/4 and 1/8 of the size, for initial errors of up to 16 px
_MIN_SIDE = 32  # pixels of the smallest image
_HALF_PX = 4  # patches of 9 x 9 pixels of their level
_NOISE = 5.0  # grey levels of difference from which the weight of a patch decreases
_ITERATIONS = 8  # on each level
_SETTLED_PX = 0.05  # mean step of the patches, in pixels of the level, at convergence


class CameraAlignment(NamedTuple):
    """Result of the alignment.

    Attributes:
        target_from_reference: (4, 4).
        score: (N,) normalised cross-correlation of each patch at half the size, or -1.
    """

    target_from_reference: Floats
    score: Floats


def half_size_pyramid(image: Bytes) -> tuple[Bytes, ...]:
    """An (H, W) uint8 image at 1/2, 1/4 and 1/8 of its size, down to the minimum size."""
    images: list[Bytes] = []
    for _ in range(_LEVELS):
        height, width = image.shape[0] // 2, image.shape[1] // 2
        if min(height, width) < _MIN_SIDE:
            break
        even = image[: 2 * height, : 2 * width]
        image = np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA))
        images.append(image)
    return tuple(images)


def align_sparse(
    reference: tuple[Bytes, ...],
    reference_xy: Floats,
    target: tuple[Bytes, ...],
    points: Floats,
    start: Floats,
    distort: Floats,
    intrinsics: Intrinsics,
) -> CameraAlignment:
    """Motion of a camera at which the points' patches look as in a reference image.

    Args:
        reference: `half_size_pyramid` of the reference image.
        reference_xy: (N, 2) pixels of the points in it, at full size.
        target: that of the camera's image.
        points: (N, 3) in the reference camera's frame.
        start: (4, 4) target_from_reference to start from.
        distort: (N, 2, 3) affine maps from ideal pixels near each point to the target's pixels.
        intrinsics: of the ideal pinhole.

    Source: Forster et al., SVO, 2014, sec. IV-A, on patches of equal mean and contrast.
    """
    motion, score = np.ascontiguousarray(start), np.full(len(points), -1.0)
    for level in reversed(range(len(reference))):
        images, at = (reference[level], target[level]), (reference_xy, points, distort)
        motion, score = _align_level(images, at, motion, intrinsics, 0.5 ** (level + 1), _HALF_PX)
    return CameraAlignment(orthonormalised(motion), score)


@compiled
def _align_level(images, at, motion, intrinsics, scale, half):  # type: ignore[no-untyped-def]
    """The motion from a start, and scores, by images of `scale` times the full size.

    Pixel p of the full size is at (p + 1/2) `scale` - 1/2.
    """
    (reference, target), (reference_xy, points, distort) = images, at
    count, side = len(points), 2 * half + 1
    stride = LANES if side + 2 <= LANES else 2 * LANES
    size, work = side * stride, workspace(half, stride)
    templates = np.empty((count, 3, size), dtype=np.float32)
    sums = np.zeros((count, 7), dtype=np.float32)
    _cut_each(reference, reference_xy, scale, half, stride, work, templates, sums)
    patches, search = (templates, sums, points), (target, distort, intrinsics, scale)
    h, b, j, score = np.empty((6, 6)), np.empty(6), np.empty((2, 6)), np.empty(count)
    found = h, b, j, score
    for _ in range(_ITERATIONS):
        per_pixel = _sum_each(patches, search, motion, half, stride, work, found)
        motion, length = take_step(h, b, motion)
        if length < _SETTLED_PX**2 * per_pixel:
            break
    return motion, score


@compiled(**NO_REFCOUNT)
def _cut_each(image, xy, scale, half, stride, work, templates, sums):  # type: ignore[no-untyped-def]
    """Templates with gradients (N, 3, size), and sums (N, 7), 0 where a patch is not usable."""
    side = 2 * half + 1
    for n in range(len(xy)):
        x, y = (xy[n, 0] + 0.5) * scale - 0.5, (xy[n, 1] + 0.5) * scale - 0.5
        if cut(image, x, y, half, stride, work):
            found = make_template(side, stride, work)
            if found[4] >= np.float32(4.0 * side * side):  # else blank
                for k in range(7):
                    sums[n, k] = found[k]
                for m in range(3):
                    for k in range(side * stride):
                        templates[n, m, k] = work[1 + m, k]


@compiled(**NO_REFCOUNT)
def _sum_each(patches, search, t, half, stride, work, found):  # type: ignore[no-untyped-def]
    """Normal equations of one Gauss-Newton step of the camera, from all patches.

        H = sum w (da/dxi)^T (grad grad^T) da/dxi,    b = -sum w (da/dxi)^T grad e,

    with a the image position of a patch, Cauchy's weight w and xi the tangent of exp(xi) @ t.
    Fills H (6, 6), b (6,) and scores (N,), -1 for patches that are not visible; j is a buffer.

    Returns:
        The value of xi^T H xi for a step of one pixel of every patch.
    """
    (templates, sums, points), (image, distort, intrinsics, scale) = patches, search
    h, b, j, score = found
    side, shift, per_pixel = 2 * half + 1, 0.5 * scale - 0.5, 1e-12
    area, flat = np.float32(side * side), image.reshape(-1)
    height, width = image.shape
    for m in range(6):
        b[m] = 0.0
        for k in range(6):
            h[m, k] = 0.0
    for n in range(len(points)):
        score[n] = -1.0
        p, a = points[n], distort[n]
        x, y, z = to_camera(t, p[0], p[1], p[2])
        if sums[n, 4] == 0.0 or z < MIN_DEPTH:
            continue
        iz = 1.0 / z
        x, y = x * iz, y * iz
        u, v = pixel(intrinsics, x, y, 1.0)
        xx, xy, x0 = a[0, 0] * scale, a[0, 1] * scale, a[0, 2] * scale + shift
        yx, yy, y0 = a[1, 0] * scale, a[1, 1] * scale, a[1, 2] * scale + shift
        left, top = xx * u + xy * v + x0 - half, yx * u + yy * v + y0 - half
        if not (left >= 0 and left + side < width - 1 and top >= 0 and top + side < height - 1):
            continue
        at = int(top) * width + int(left)
        if at + side * width + stride >= len(flat):
            continue
        mean, hxx, hxy, hyy, variance, bx, by = sums[n]
        ax, ay = np.float32(left - int(left)), np.float32(top - int(top))
        blend_rows(flat, width, at, ax, mean, side + 1, stride, work)
        total, squares, cross, gx, gy = compare(side * stride, stride, ay, work, templates[n])
        variance_now = max(squares - total * total / area, np.float32(1e-6))
        gain = np.sqrt(variance / variance_now)
        ex, ey = gx * gain - bx, gy * gain - by
        score[n] = cross / np.sqrt(variance * variance_now)
        # Cauchy's weight of the mean squared residual per pixel.
        weight = 1.0 / (_NOISE * _NOISE + 2.0 * variance * (1.0 - score[n]) / area)
        by_u, by_v = by_cam_from_world(intrinsics.fx, intrinsics.fy, x, y, iz)
        for m in range(6):
            j[0, m], j[1, m] = xx * by_u[m] + xy * by_v[m], yx * by_u[m] + yy * by_v[m]
        for m in range(6):
            gu = weight * (j[0, m] * hxx + j[1, m] * hxy)
            gv = weight * (j[0, m] * hxy + j[1, m] * hyy)
            b[m] -= weight * (j[0, m] * ex + j[1, m] * ey)
            for k in range(6):
                h[m, k] += gu * j[0, k] + gv * j[1, k]
        per_pixel += weight * 0.5 * (hxx + hyy)
    return per_pixel
