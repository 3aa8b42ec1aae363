"""Places in an image that a detector has found, before they are described."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.types import Bools, Bytes, Floats32, Ints


@dataclass(frozen=True, eq=False)
class Detections:
    """Detected places as a struct of arrays; row i of each belongs together.

    Attributes:
        xy: (N, 2) float32 pixels.
        size: (N,) float32 diameter of the described neighbourhood in pixels.
        angle: (N,) float32 orientation in radians, NaN without one.
        response: (N,) float32 strength, comparable within one image.
        packed_octave: (N,) int32, OpenCV's octave, in whatever way its detector packs it.
        class_id: (N,) int32, OpenCV's class; of AKAZE and KAZE the level of the scale space.
    """

    xy: Floats32
    size: Floats32
    angle: Floats32
    response: Floats32
    packed_octave: NDArray[np.int32]
    class_id: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.xy)

    def select(self, rows: Bools | Ints) -> Detections:
        """Some of them."""
        return Detections(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def in_fixed_order(self) -> Detections:
        """Strongest first, then by place: detectors with several threads find them in any order."""
        keys = (self.size, self.xy[:, 0], self.xy[:, 1], -self.response)
        return self.select(np.lexsort((self.angle, *keys)))

    def as_opencv(self) -> list[cv2.KeyPoint]:
        """The same as OpenCV's objects; angles in degrees, -1 without one."""
        angle = np.where(np.isnan(self.angle), -1.0, np.rad2deg(self.angle) % 360.0)
        numbers = (self.xy[:, 0], self.xy[:, 1], self.size, angle, self.response)
        whole = (self.packed_octave, self.class_id)
        rows = zip(*(each.tolist() for each in (*numbers, *whole)), strict=True)
        return [cv2.KeyPoint(*row) for row in rows]


class Detector(Protocol):
    """Finds places in an image that can be found again in others."""

    @property
    def base_size(self) -> float:
        """Diameter in pixels of what it detects at its finest scale."""
        ...

    @property
    def has_scale(self) -> bool:
        """Whether it finds the scale of a place; otherwise it is run on an image pyramid."""
        ...

    def detect(self, image: Bytes, mask: Bytes | None = None) -> Detections:
        """Places in an (H, W) uint8 image where `mask` is not 0, in a fixed order."""
        ...


def from_opencv(keypoints: Any) -> Detections:
    """Detections of OpenCV's objects."""
    rows = [(*k.pt, k.size, k.angle, k.response, k.octave, k.class_id) for k in keypoints]
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    angle = np.where(table[:, 3] == -1.0, np.nan, np.deg2rad(table[:, 3]))
    return Detections(
        table[:, :2].astype(np.float32),
        table[:, 2].astype(np.float32),
        angle.astype(np.float32),
        table[:, 4].astype(np.float32),
        table[:, 5].astype(np.int32),
        table[:, 6].astype(np.int32),
    )


def at_points(xy: Floats32, response: Floats32, size: float) -> Detections:
    """Detections of one scale, without orientation."""
    count = len(xy)
    return Detections(
        np.asarray(xy, dtype=np.float32).reshape(-1, 2),
        np.full(count, size, np.float32),
        np.full(count, np.nan, np.float32),
        np.asarray(response, dtype=np.float32),
        np.zeros(count, np.int32),
        np.full(count, -1, np.int32),
    )


def joined(parts: list[Detections]) -> Detections:
    """All detections of several lists; at least one."""
    names = [field.name for field in fields(Detections)]
    return Detections(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})
