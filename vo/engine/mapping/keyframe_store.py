"""Contract of a receiver of keyframes that the window does not move any more.

A keyframe is handed over as it is then: with its features and their descriptors, its observations,
its covariance, the landmarks that it observes, and its image. Place recognition and loop closure
build on it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vo.base.types import Bytes, Descriptors, Floats, Ints
from vo.engine.mapping.keyframe import Keyframe


class StoredLandmarks(NamedTuple):
    """Landmarks that a keyframe observes; rows belong together.

    Attributes:
        id: (n,) increasing.
        xyz: (n, 3) in the world.
        normal: (n, 3) of the surface, of any length.
        descriptor: (n, width).
        octave: (n,).
        angle: (n,) radians.
        sigma: (n,) standard deviation of the position, all axes together, given exact poses;
            infinite if the observations in the map do not determine the depth.
    """

    id: Ints
    xyz: Floats
    normal: Floats
    descriptor: Descriptors
    octave: NDArray[np.int32]
    angle: NDArray[np.float32]
    sigma: Floats


class KeyframeStore(Protocol):
    """Receives keyframes, in the order of their ids, when the window has left them or at `close`.

    With `features.rescue`, their descriptors are of the kind that the map has at that time.
    """

    def add(
        self, keyframe: Keyframe, landmarks: Callable[[], StoredLandmarks], image: Bytes
    ) -> None:
        """Take over a keyframe, whose pose is changed only where the calibration is corrected.

        `landmarks` returns copies of those that it observes, until this call ends; its rectified
        image (H, W) of camera 0 is overwritten after it.
        """
        ...


class MemoryKeyframeStore:
    """Keeps all keyframes in memory: some 100 kB each, without images.

    Attributes:
        keyframes: in the order of their ids.
        landmarks: of each keyframe, by its id.
    """

    def __init__(self) -> None:
        self.keyframes: list[Keyframe] = []
        self.landmarks: dict[int, StoredLandmarks] = {}

    def add(
        self, keyframe: Keyframe, landmarks: Callable[[], StoredLandmarks], image: Bytes
    ) -> None:
        """Keep a keyframe, without its image."""
        self.keyframes.append(keyframe)
        self.landmarks[keyframe.id] = landmarks()
