"""Sub-pixel alignment of image patches, warped as they should look in the target image.

A corner is detected to about a pixel of its pyramid level. Alignment improves that to a tenth of a
full-resolution pixel, the precision that geometry needs.

Source: Baker and Matthews, "Lucas-Kanade 20 years on", IJCV 2004 (inverse compositional), on
patches of equal mean and contrast, so that a change of exposure does not move them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.config import PatchConfig
from vo.base.types import Bools, Bytes, Floats, Ints
from vo.engine.frontend import patch_kernels

_MAX_HALF_PX = 10
_MAX_ITERATIONS = 12


class Patches(NamedTuple):
    """Patches of reference images; rows belong together.

    Attributes:
        images: (M, H, W) uint8 stack of reference images.
        image: (N,) index of the image of each patch.
        xy: (N, 2) pixel at the centre of each patch.
        reference_from_target: (N, 2, 2) how steps in the target image map to the reference, or
            (N, 3, 2) with a third row of `homographies`; None without a change of shape.
    """

    images: Bytes
    image: Ints
    xy: Floats
    reference_from_target: Floats | None = None


class Alignment(NamedTuple):
    """Result of an alignment.

    Attributes:
        xy: (N, 2) float64 pixels in the target image.
        score: (N,) zero-mean normalised cross-correlation there, -1 where it failed.
        converged: (N,) whether the search converged inside the image.
        nearly: (N,) whether it converged or was close to it, which is a poor measurement.
        sigma_px: (N,) standard deviation of xy, mean of both axes, from the inverse of J^T J times
            the variance of the residual, as if it were noise of single pixels. The true errors are
            about twice as large, uniformly.
    """

    xy: Floats
    score: Floats
    converged: Bools
    nearly: Bools
    sigma_px: Floats


def patches_of(image: Bytes, xy: Floats, reference_from_target: Floats | None = None) -> Patches:
    """Patches around pixels (N, 2) of a single image (H, W)."""
    return Patches(image[None], np.zeros(len(xy), np.int64), xy, reference_from_target)


class PatchAligner:
    """Finds patches in other images to sub-pixel, with the settings of a run."""

    def __init__(self, config: PatchConfig) -> None:
        self._config = config

    @property
    def sigma_px(self) -> float:
        """Standard deviation of an aligned position, pixels."""
        return self._config.sigma_px

    @property
    def max_shift_px(self) -> float:
        """Maximum shift of an aligned patch from its predicted position, pixels."""
        return self._config.max_shift_px

    def align(self, patches: Patches, target: Bytes, start_xy: Floats) -> Alignment:
        """Find patches in one image (H, W), starting at (N, 2) pixels."""
        only = np.zeros(len(start_xy), dtype=np.int64)
        return self.align_in(patches, target[None], only, start_xy)

    def align_in(
        self, patches: Patches, targets: Bytes, target: Ints, start_xy: Floats
    ) -> Alignment:
        """Find each patch in one (N,) of several images (T, H, W), starting at (N, 2) pixels."""
        return align_between(patches, targets, target, start_xy, half_px=self._config.half_px)

    def is_similar(self, found: Alignment) -> Bools:
        """(N,) whether the correlation at the found position is high enough."""
        return np.asarray(found.score >= self._config.min_score)

    def is_found(self, found: Alignment) -> Bools:
        """(N,) whether the alignment converged and the correlation is high enough."""
        return found.converged & self.is_similar(found)


def align_between(
    patches: Patches,
    targets: Bytes,
    target: Ints,
    start_xy: Floats,
    *,
    half_px: int,
    iterations: int = _MAX_ITERATIONS,
) -> Alignment:
    """Find N patches, of 2 * half_px + 1 pixels a side, as `PatchAligner.align_in` does.

    Raises:
        ValueError: patches are too large.
    """
    if half_px > _MAX_HALF_PX:
        raise ValueError(f"half_px is {half_px}, at most {_MAX_HALF_PX}")
    warp = patches.reference_from_target
    stretch = np.empty((0, 2, 2)) if warp is None else warp
    xy, score, converged, nearly, sigma_px = patch_kernels.align(
        np.ascontiguousarray(patches.images),
        np.ascontiguousarray(patches.image, dtype=np.int64),
        np.ascontiguousarray(patches.xy, dtype=np.float64),
        np.ascontiguousarray(stretch, dtype=np.float64),
        np.ascontiguousarray(targets),
        np.ascontiguousarray(target, dtype=np.int64),
        np.ascontiguousarray(start_xy, dtype=np.float64),
        half_px,
        iterations,
    )
    return Alignment(xy, score, converged, nearly, sigma_px)
