"""Images with so few pixels that the path is inaccurate."""

from __future__ import annotations

from vo.base.faults import Fault, FaultKind

# Errors grow with the angle of a pixel, and with fewer features. The shared clips at 25 to 35 % of
# their size, 15,000 to 56,000 pixels, have 5 to 28 times the error; at half of it, 64,000 pixels,
# up to 3 times.
SMALL_PIXELS = 60_000


def size_faults(pixels: int) -> tuple[Fault, ...]:
    """The fault of images with this number of pixels; the value is in thousands."""
    if pixels >= SMALL_PIXELS:
        return ()
    return (Fault(FaultKind.SMALL_IMAGES, value=1e-3 * pixels),)
