"""Sub-pixel refinement: a patch of a reference image, warped as it should look now, is aligned.

An ORB corner is known to about a pixel of its pyramid level; the alignment brings that to a tenth
of a full-resolution pixel, which is what geometry needs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.frontend import patch_kernels
from vo.types import Bools, Bytes, Floats, Ints

_MAX_HALF = 10


class Alignment(NamedTuple):
    """Where patches were found.

    Attributes:
        xy: (N, 2) float64 pixels in the target image.
        score: (N,) zero-mean normalised cross-correlation there, -1 where it failed.
        converged: (N,) whether the search settled inside the image.
        nearly: (N,) whether it did, or would have in a few more steps: a poor measurement.
        sigma_px: (N,) standard deviation of xy, mean of both axes, if what is left between the
            patches were noise of single pixels: J^T J of the patch inverted, times its variance.
            Of noisy patches errors are about twice as large, good and bad ones alike.
    """

    xy: Floats
    score: Floats
    converged: Bools
    nearly: Bools
    sigma_px: Floats


def align_patches(
    references: Bytes,
    reference: Ints,
    reference_xy: Floats,
    target_from_reference: Floats,
    target: Bytes,
    start_xy: Floats,
    *,
    half_px: int = 5,
    iterations: int = 12,
) -> Alignment:
    """Find the position in `target` of patches around `reference_xy`, to sub-pixel.

    Args:
        references: (M, H, W) uint8 stack of reference images.
        reference: (N,) which of them each patch comes from.
        reference_xy: (N, 2) pixel at the patch's centre.
        target_from_reference: (N, 2, 2) how the patch is stretched on its way to the target.
        target: (H, W) uint8.
        start_xy: (N, 2) where to begin in the target.
        half_px: the patch has 2 * half_px + 1 pixels a side.
        iterations: most steps of the search.

    Source: Baker and Matthews, "Lucas-Kanade 20 years on", IJCV 2004 (inverse compositional),
        on patches of equal mean and contrast, so that a change of exposure does not move them.
    """
    return align_between(
        references,
        reference,
        reference_xy,
        np.asarray(np.linalg.inv(target_from_reference), dtype=np.float64),
        target[None],
        np.zeros(len(reference_xy), dtype=np.int64),
        start_xy,
        half_px=half_px,
        iterations=iterations,
    )


def align_between(
    references: Bytes,
    reference: Ints,
    reference_xy: Floats,
    reference_from_target: Floats | None,
    targets: Bytes,
    target: Ints,
    start_xy: Floats,
    *,
    half_px: int,
    iterations: int = 12,
) -> Alignment:
    """Find patches of several images in several others at once; otherwise as `align_patches`.

    Args:
        references: (M, H, W) uint8 stack of reference images.
        reference: (N,) which of them each patch comes from.
        reference_xy: (N, 2) pixel at the patch's centre.
        reference_from_target: (N, 2, 2) the inverse of how the patch is stretched on its way to
            the target; None if no patch is.
        targets: (T, H, W) uint8 stack of the images to look in.
        target: (N,) which of them each patch is looked for in.
        start_xy: (N, 2) where to begin in the target.
        half_px: the patch has 2 * half_px + 1 pixels a side.
        iterations: most steps of the search.
    """
    if half_px > _MAX_HALF:
        raise ValueError(f"half_px is {half_px}, at most {_MAX_HALF}")
    stretch = np.empty((0, 2, 2)) if reference_from_target is None else reference_from_target
    xy, score, converged, nearly, sigma_px = patch_kernels.align(
        np.ascontiguousarray(references),
        np.ascontiguousarray(reference, dtype=np.int64),
        np.ascontiguousarray(reference_xy, dtype=np.float64),
        np.ascontiguousarray(stretch, dtype=np.float64),
        np.ascontiguousarray(targets),
        np.ascontiguousarray(target, dtype=np.int64),
        np.ascontiguousarray(start_xy, dtype=np.float64),
        half_px,
        iterations,
    )
    return Alignment(xy, score, converged, nearly, sigma_px)
