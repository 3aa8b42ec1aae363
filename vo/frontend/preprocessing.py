"""A frame made ready: rectified, and its features found and undistorted once they are needed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vo.config import Config
from vo.frontend.camera_alignment import smaller_images
from vo.frontend.lazy_future import LazyFuture
from vo.frontend.orb import OrbDetector
from vo.frontend.vertical_disparity import VerticalDisparityCorrection, View
from vo.geometry.rectification import RectifiedRig
from vo.geometry.vertical_disparity_model import VerticalDisparity
from vo.scheduling import give_way
from vo.types import Bools, Bytes, Floats32, Frame, Keypoints


@dataclass(frozen=True, eq=False)
class PreprocessedFrame:
    """What tracking works on.

    Attributes:
        index: number of the frame in its source.
        stamp_ns: its time.
        image0: (H, W) uint8 working image of the left camera.
        image1: the same of the right camera, or None.
        smaller: image0 at 1/2, 1/4 and 1/8 of its size.
        left: features of image0 inside the ideal camera's field of view, found when they are asked
            for, like those on the right: frames that are no keyframes seldom need them.
        right: features of image1.
        depth: (H, W) metres at the pixels of image0, 0 where unknown, or None.
        path: the file that holds the left image as recorded, or None.
        rows: by how much rows of recorded pairs were found to differ until this frame, or None.
        corrected: what of that is corrected in image1.
    """

    index: int
    stamp_ns: int
    image0: Bytes
    image1: Bytes | None
    smaller: tuple[Bytes, ...]
    left: LazyFuture[Keypoints]
    right: LazyFuture[Keypoints] | None = None
    depth: Floats32 | None = None
    path: Path | None = None
    rows: VerticalDisparity | None = None
    corrected: VerticalDisparity = VerticalDisparity()

    @property
    def keypoints(self) -> Keypoints:
        """The features of image0."""
        return self.left.result()

    @property
    def used_keypoints_xy(self) -> Floats32:
        """The pixels (N, 2) of the features of image0; none if nobody asked for them."""
        return self.keypoints.xy if self.left.is_used else np.empty((0, 2), np.float32)

    def begin_features(self) -> None:
        """Have the features looked for, left and right at once if there are cores for it."""
        self.left.begin()
        if self.right is not None:
            self.right.begin()

    @property
    def has_disparity(self) -> bool:
        """Whether features can be measured in depth, by a right image or otherwise."""
        return self.image1 is not None or self.depth is not None


class FramePreprocessor:
    """Makes frames ready, left and right each in a thread of its own if there are cores for it.

    Rows of the right images are brought in line on the way, see `vo.frontend.vertical_disparity`.

    Attributes:
        begins_features: whether features, too, are looked for a frame ahead. Those that nobody
            asks for then cost time, and nothing else.
    """

    def __init__(self, config: Config, *, threads: int) -> None:
        self.begins_features = True
        self._rows = VerticalDisparityCorrection(config)
        self._detectors = (OrbDetector(config.features), OrbDetector(config.features))
        names = ("left", "right") if threads > 1 else ()
        self._pools = [
            ThreadPoolExecutor(1, thread_name_prefix=name, initializer=give_way) for name in names
        ]

    def later(self, frame: Frame, rig: RectifiedRig) -> LazyFuture[PreprocessedFrame]:
        """A frame that will be made ready."""
        pool = self._pools[0] if self._pools else None
        return LazyFuture(lambda: self._prepare(frame, rig), pool)

    def ahead(
        self, frames: Iterable[Frame], rig: RectifiedRig
    ) -> Iterator[LazyFuture[PreprocessedFrame]]:
        """All frames, each begun while the one before it is worked on."""
        waiting: LazyFuture[PreprocessedFrame] | None = None
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

    def _prepare(self, frame: Frame, rig: RectifiedRig) -> PreprocessedFrame:
        """Rectify a frame; have its features looked for."""
        image0 = rig.rectify(frame.image0, 0)
        left = LazyFuture(lambda: self._left(image0, rig), self._pool_of_left(rig))
        image1, right = None, None
        if rig.is_stereo and frame.image1 is not None:
            image1 = self._rows.aligned(rig).rectify(frame.image1, 1)
            right = self._right(image1)
            if self._rows.asks():
                keypoints = self._left(image0, rig)
                left = LazyFuture(lambda: keypoints, None)  # a thread cannot wait for itself
                one, other = View(image0, keypoints), View(image1, right.result())
                if self._rows.learn(one, other, rig):
                    image1 = self._rows.aligned(rig).rectify(frame.image1, 1)
                    right = self._right(image1)
        working = PreprocessedFrame(
            frame.index,
            frame.stamp_ns,
            image0,
            image1,
            smaller_images(image0),
            left,
            right,
            None if frame.depth is None else rig.rectify_depth(frame.depth),
            frame.path,
            self._rows.found,
            self._rows.corrected,
        )
        if self.begins_features:
            working.begin_features()
        return working

    def _pool_of_left(self, rig: RectifiedRig) -> ThreadPoolExecutor | None:
        """The thread for features of left images; of a single camera the other, which is idle."""
        if not self._pools:
            return None
        return self._pools[0 if rig.is_stereo else 1]

    def _left(self, image: Bytes, rig: RectifiedRig) -> Keypoints:
        # Nothing in the left images' thread waits for features of a single camera, so that these
        # may wait for it.
        helper = self._pools[0] if self._pools and not rig.is_stereo else None
        keypoints = self._detectors[0].detect(image, helper)
        inside = np.asarray(np.isfinite(rig.undistort(keypoints.xy)).all(axis=1))
        return keypoints if inside.all() else select(keypoints, inside)

    def _right(self, image: Bytes) -> LazyFuture[Keypoints]:
        pool = self._pools[1] if self._pools else None
        return LazyFuture(lambda: self._detectors[1].detect(image), pool)


def select(keypoints: Keypoints, rows: Bools) -> Keypoints:
    """Some rows of keypoints."""
    return Keypoints(
        keypoints.xy[rows],
        keypoints.octave[rows],
        keypoints.angle[rows],
        keypoints.response[rows],
        keypoints.descriptor[rows],
    )
