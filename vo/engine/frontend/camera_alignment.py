"""Camera motion by joint alignment of the patches of many points (sparse image alignment)."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import orthonormalised
from vo.base.types import Bytes, Floats
from vo.engine.frontend import patch_kernels
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
        scale = 0.5 ** (level + 1)  # pixel p of the full size is at (p + 1/2) s - 1/2
        templates, sums = patch_kernels.cut_all(
            reference[level], (reference_xy + 0.5) * scale - 0.5, _HALF_PX
        )
        pixel_from_ideal = distort * scale
        pixel_from_ideal[:, :, 2] += 0.5 * scale - 0.5
        for _ in range(_ITERATIONS):
            h, b, per_pixel, score = patch_kernels.step_together(
                *(templates, sums, target[level], points, pixel_from_ideal, intrinsics),
                *(motion, _HALF_PX, _NOISE),
            )
            motion, length = take_step(h, b, motion)
            if length < _SETTLED_PX**2 * per_pixel:
                break
    return CameraAlignment(orthonormalised(motion), score)
