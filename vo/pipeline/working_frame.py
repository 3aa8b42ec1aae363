"""A frame made ready: rectified, its features found and undistorted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vo.config import FeaturesConfig
from vo.features.orb import OrbDetector
from vo.geometry.rectification import WorkingRig
from vo.pipeline.later import Later
from vo.types import Bools, Bytes, Floats, Floats32, Frame, Keypoints


@dataclass(frozen=True, eq=False)
class WorkingFrame:
    """What tracking works on.

    Attributes:
        index: number of the frame in its source.
        stamp_ns: its time.
        image0: (H, W) uint8 working image of the left camera.
        image1: the same of the right camera, or None.
        keypoints: features of image0, all inside the ideal camera's field of view.
        ideal_xy: (N, 2) float64 their ideal pinhole pixels.
        right: features of image1, found when they are asked for: few frames need them.
        depth: (H, W) metres at the pixels of image0, 0 where unknown, or None.
        path: the file that holds the left image as recorded, or None.
    """

    index: int
    stamp_ns: int
    image0: Bytes
    image1: Bytes | None
    keypoints: Keypoints
    ideal_xy: Floats
    right: Later[Keypoints] | None = None
    depth: Floats32 | None = None
    path: Path | None = None

    @property
    def has_disparity(self) -> bool:
        """Whether features can be measured in depth, by a right image or otherwise."""
        return self.image1 is not None or self.depth is not None


class Preparation:
    """Makes frames ready, left and right each in a thread of its own if there are cores for it."""

    def __init__(self, config: FeaturesConfig, *, threads: int) -> None:
        self._detectors = (OrbDetector(config), OrbDetector(config))
        names = ("left", "right") if threads > 1 else ()
        self._pools = [ThreadPoolExecutor(1, thread_name_prefix=name) for name in names]

    def later(self, frame: Frame, rig: WorkingRig) -> Later[WorkingFrame]:
        """A frame that will be made ready."""
        pool = self._pools[0] if self._pools else None
        return Later(lambda: self._prepare(frame, rig), pool)

    def ahead(self, frames: Iterable[Frame], rig: WorkingRig) -> Iterator[Later[WorkingFrame]]:
        """All frames, each begun while the one before it is worked on."""
        waiting: Later[WorkingFrame] | None = None
        try:
            for frame in frames:
                coming = self.later(frame, rig)
                coming.begin()
                if waiting is not None:
                    yield waiting
                waiting = coming
        except Exception:
            if waiting is not None:  # what was read before the error still counts
                yield waiting
            raise
        if waiting is not None:
            yield waiting

    def close(self) -> None:
        """End the threads."""
        for pool in self._pools:
            pool.shutdown(cancel_futures=True)

    def _prepare(self, frame: Frame, rig: WorkingRig) -> WorkingFrame:
        """Rectify a frame and find its features."""
        image0 = rig.rectify(frame.image0, 0)
        image1, right = None, None
        if rig.is_stereo and frame.image1 is not None:
            image1 = rig.rectify(frame.image1, 1)
            right = self._right(image1)
        keypoints = self._detectors[0].detect(image0)
        ideal = rig.ideal_from_image(keypoints.xy.astype(np.float64))
        inside = np.asarray(np.isfinite(ideal).all(axis=1))
        if not inside.all():
            keypoints, ideal = select(keypoints, inside), ideal[inside]
        return WorkingFrame(
            frame.index,
            frame.stamp_ns,
            image0,
            image1,
            keypoints,
            ideal,
            right,
            None if frame.depth is None else rig.rectify_depth(frame.depth),
            frame.path,
        )

    def _right(self, image: Bytes) -> Later[Keypoints]:
        pool = self._pools[1] if self._pools else None
        return Later(lambda: self._detectors[1].detect(image), pool)


def select(keypoints: Keypoints, rows: Bools) -> Keypoints:
    """Some rows of keypoints."""
    return Keypoints(
        keypoints.xy[rows],
        keypoints.octave[rows],
        keypoints.angle[rows],
        keypoints.response[rows],
        keypoints.descriptor[rows],
    )
