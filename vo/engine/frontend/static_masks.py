"""Masks that hold for all images of a camera: the vehicle's own body, text, a border.

They are given for the images as recorded, and rectified once, not for every frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vo.base.config import MasksConfig
from vo.base.errors import ConfigError
from vo.base.geometry.rectification import RectifiedRig
from vo.base.images.recorded_masks import CAMERA_NAMES, read_masks
from vo.base.types import Bytes, Rig

# Half the side of a descriptor. Patches, which are smaller, then have no hidden pixel, wherever
# alignment moves them. On kitti06 with a drawn-in bonnet 10 and 16 are better than 6 and 24.
_GROWTH_PX = 16


def recorded_masks(config: MasksConfig, rig: Rig) -> tuple[Bytes | None, ...]:
    """Masks (H, W) of the recorded images of each camera, as settings have them."""
    return read_masks(rig, config.files, config.ignore, config.roi)


class StaticMasks:
    """The masks of a run at the pixels of rectified images.

    They are grown by 16 pixels, so that no patch around a pixel outside of them has a hidden pixel.

    Attributes:
        left: (H, W) uint8 of camera 0, 0 or 255; None without one.
        hidden: ratio of the recorded images that is hidden, by camera.

    Raises:
        ConfigError: nothing is left of an image.
    """

    def __init__(self, rig: RectifiedRig, recorded: Sequence[Bytes | None] = ()) -> None:
        left, right = (*recorded, None, None)[:2]
        self.hidden = tuple(_hidden(mask) for mask in recorded)
        self._rig = self._right_rig = rig
        self._recorded_right = right
        self.left = None if left is None else _grown(rig.rectify(left, 0))
        self._right = None if right is None else _grown(rig.rectify(right, 1))
        for name, mask in zip(CAMERA_NAMES, (self.left, self._right), strict=True):
            if mask is not None and not mask.any():
                raise ConfigError(
                    f"masks leave nothing of the {name} images, with {_GROWTH_PX} pixels around "
                    "what they hide: black (0) is not used, all other pixels are"
                )

    def right(self, rig: RectifiedRig) -> Bytes | None:
        """(H, W) uint8 of camera 1 as a rig rectifies it; None without one."""
        if self._recorded_right is not None and rig is not self._right_rig:
            self._right_rig = rig
            self._right = _grown(rig.rectify(self._recorded_right, 1))
        return self._right

    def left_with(self, mask: Bytes | None) -> Bytes | None:
        """The mask of camera 0 with one (H, W) of a single recorded image."""
        if mask is None:
            return self.left
        of_frame = _grown(self._rig.rectify(mask, 0))
        return of_frame if self.left is None else np.minimum(of_frame, self.left)


def _grown(rectified: Bytes) -> Bytes:
    """A mask (H, W), 0 or 255, of which a rectification made values between them, grown."""
    used = np.where(rectified == 255, np.uint8(255), np.uint8(0))
    side = 2 * _GROWTH_PX + 1
    return np.asarray(cv2.erode(used, np.ones((side, side), np.uint8)))


def _hidden(mask: Bytes | None) -> float:
    return 0.0 if mask is None else 1.0 - float(np.count_nonzero(mask)) / mask.size
