"""How recorded images show what masks hide."""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.types import Bytes

_BRIGHTNESS = 0.35  # of hidden pixels


def dimmed(image: Bytes, mask: Bytes | None) -> Bytes:
    """An image (H, W) that is darker where a mask (H, W) is 0."""
    if mask is None:
        return image
    dark = cv2.convertScaleAbs(image, alpha=_BRIGHTNESS)
    return np.asarray(np.where(mask > 0, image, dark))
