"""The contract of a capture device: one camera, or several that give their images together."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import NamedTuple, Protocol

import cv2
import numpy as np

from vo.base.types import Bytes, Rig
from vo.recordings.sources.images import Pixels

_log = logging.getLogger(__name__)


class CapturedImages(NamedTuple):
    """Images of one time.

    Attributes:
        stamp_ns: capture time of the first image, nanoseconds since 1970 on the host's clock.
        images: (H, W) uint8 grey, by camera.
    """

    stamp_ns: int
    images: tuple[Bytes, ...]


class Device(Protocol):
    """A connected device, used by one thread.

    Attributes:
        rig: its own calibration from the factory, of one camera for each image; None without one.
    """

    rig: Rig | None

    def read(self) -> CapturedImages:
        """Wait for the next images, of increasing stamps.

        Raises:
            SourceError: the connection is lost, or nothing came for several seconds.
        """
        ...

    def close(self) -> None:
        """End the connection; never fails."""
        ...


Connect = Callable[[], Device]
"""Connects to a device; raises SourceError if it does not answer."""


def warn_of_untested(name: str, package: str) -> None:
    """Warn that nobody has tried a source with the camera itself."""
    _log.warning(
        "%s: written from the documentation of %s and tested without a camera; check its first "
        "results, and report what you find",
        name,
        package,
    )


def as_grey(image: Pixels) -> Bytes:
    """An 8-bit image as (H, W) grey; (H, W, 3) is BGR."""
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.shape[2] == 3 else image[:, :, 0]
    return np.ascontiguousarray(image, dtype=np.uint8)
