"""Records of object recognition: stored objects, and what is found of them in an image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vo.base.types import Bytes, Descriptors, Floats, Floats32

Codes = NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class Part:
    """A flat side of an object, in the pixels of its first image.

    Attributes:
        xy: (N, 2) places of the features; one that several images show may occur several times.
        descriptor: (N, width) of them, float ones compact (`scene_features.compact`).
        code: (N, 4) uint64 of them, for the index.
        angle: (N,) radians in the image, NaN without orientation.
        size: (N,) relative to the smallest features; 1 without scale.
        outline: (4, 2) corners of the image: upper left, upper right, lower right, lower left.
        unit_m: metres of one pixel; NaN if it is not known.
        thumbnail: (h, w) uint8, of the first image.
        image_size: (width, height) of that image.
    """

    xy: Floats32
    descriptor: Descriptors
    code: Codes
    angle: Floats32
    size: Floats32
    outline: Floats32
    unit_m: float
    thumbnail: Bytes
    image_size: tuple[int, int]


@dataclass(frozen=True, eq=False)
class StoredObject:
    """An object of a database."""

    name: str
    parts: tuple[Part, ...]
    images: int

    @property
    def features(self) -> int:
        """Number of features of all parts."""
        return sum(len(part.xy) for part in self.parts)


@dataclass(frozen=True, eq=False)
class FoundObject:
    """An instance of an object in an image.

    Attributes:
        part: number of the side of it that is seen.
        confidence: probability that the object is there, 0 to 1.
        inliers: features that agree.
        outline: (4, 2) pixels of the corners of the stored image, perhaps beyond the image.
        homography: (3, 3) pixels of the stored image to those of this one, without the distortion
            of the lens.
        cam_from_object: (4, 4) pose in metres; the object's frame is at the centre of the stored
            image, x to its right, y down, z away from who looks at it. None without a calibration,
            and of a side of unknown width.
    """

    name: str
    part: int
    confidence: float
    inliers: int
    outline: Floats
    homography: Floats
    cam_from_object: Floats | None
