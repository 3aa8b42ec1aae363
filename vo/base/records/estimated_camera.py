"""Record of a camera that was estimated from the images of a recording."""

from __future__ import annotations

from typing import NamedTuple

_MAX_RELATIVE_SIGMA = 0.03  # of the focal length, above which a path is not to be trusted


class EstimatedCamera(NamedTuple):
    """Focal length and its standard deviation, principal point, and `radtan` coefficients.

    Attributes:
        frames: those that it was estimated from.
        told_by: where the first guess is from, such as EXIF; empty for the images alone.
        readout_s: time from the first to the last row by the images; 0 where they show none, or it
            was known.
        readout_sigma_s: its standard deviation.
    """

    focal_px: float
    sigma_px: float
    cx: float
    cy: float
    k1: float
    k2: float
    frames: int
    told_by: str = ""
    readout_s: float = 0.0
    readout_sigma_s: float = 0.0

    @property
    def is_uncertain(self) -> bool:
        """Whether the motion has hardly shown it."""
        return self.sigma_px > _MAX_RELATIVE_SIGMA * self.focal_px

    @property
    def in_words(self) -> str:
        """For people, and for comments."""
        told = f" (first guess: {self.told_by})" if self.told_by else ""
        if self.readout_s:
            readout_ms, sigma_ms = 1e3 * self.readout_s, 1e3 * self.readout_sigma_s
            told += f", rows read within {readout_ms:.1f} ± {sigma_ms:.1f} ms"
        return (
            f"focal length {self.focal_px:.1f} ± {self.sigma_px:.1f} px, principal point "
            f"({self.cx:.1f}, {self.cy:.1f}), k1 {self.k1:+.4f}, k2 {self.k2:+.4f}{told}"
        )
