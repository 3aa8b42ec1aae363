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
class Solid:
    """A solid object, as points with the features of the views that show them.

    Attributes:
        xyz: (N, 3) place of each feature in the object's frame; points with several features occur
            several times.
        ray: (N, 3) unit vectors from there to the camera that saw the feature.
        sigma: (N,) standard deviation of the place along it.
        descriptor: (N, width), as of a part.
        box: (2, 3) lower and upper corner of what the points fill.
        is_metric: whether lengths are metres; else poses are not given.
    """

    xyz: Floats32
    ray: Floats32
    sigma: Floats32
    descriptor: Descriptors
    box: Floats32
    is_metric: bool


@dataclass(frozen=True, eq=False)
class StoredObject:
    """An object of a database: flat sides, or a solid without any."""

    name: str
    parts: tuple[Part, ...]
    images: int
    solid: Solid | None = None

    @property
    def features(self) -> int:
        """Number of features of all parts."""
        return sum(len(part.xy) for part in self.parts) + (len(self.solid.xyz) if self.solid else 0)


@dataclass(frozen=True, eq=False)
class FoundObject:
    """An instance of an object in an image.

    Attributes:
        part: number of the side of it that is seen.
        confidence: probability that the object is there, 0 to 1.
        inliers: features that agree.
        outline: (4, 2) pixels of the corners of the stored image, perhaps beyond the image; of a
            solid, of the rectangle about its box.
        homography: (3, 3) pixels of the stored image to those of this one, without the distortion
            of the lens; None of a solid.
        cam_from_object: (4, 4) pose in metres; the object's frame is at the centre of the stored
            image, x to its right, y down, z away from who looks at it. None without a calibration,
            and of a side of unknown width.
        covariance: (6, 6) of the pose in the frame of the camera: tangent (rx ry rz tx ty tz) of
            exp(xi) @ cam_from_object, in rad and m; None without a pose.
        edges: (12, 2, 2) pixels of the ends of the edges of a solid's box, else None.
    """

    name: str
    part: int
    confidence: float
    inliers: int
    outline: Floats
    homography: Floats | None
    cam_from_object: Floats | None
    covariance: Floats | None = None
    edges: Floats | None = None
