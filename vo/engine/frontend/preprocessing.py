"""Preprocessing of frames: rectification, image pyramid, and features on demand."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from vo.base.compiling.signatures import usual_array
from vo.base.faults import Fault, FaultKind
from vo.base.frozen import frozen
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.base.scheduling import give_way
from vo.base.types import Bytes, Floats32, Frame, Keypoints
from vo.engine.frontend.camera_alignment import half_size_pyramid
from vo.engine.frontend.contracts import FeatureExtractor
from vo.engine.frontend.contrast import ContrastCorrection
from vo.engine.frontend.image_faults import ImageFaults, size_faults
from vo.engine.frontend.image_fixed import ImageFixed, ImageFixedDetector
from vo.engine.frontend.image_repetition import Repetition, RepetitionDetector
from vo.engine.frontend.lazy_future import LazyFuture, each_started_early, finished
from vo.engine.frontend.missing_rows import MissingRows
from vo.engine.frontend.pair_check import PairCheck
from vo.engine.frontend.pair_matching import View
from vo.engine.frontend.recent_frames import RecentFrames, RecordedFrame
from vo.engine.frontend.static_masks import StaticMasks
from vo.engine.frontend.stereo_time_offset import TimeOffsetEstimator
from vo.engine.frontend.vertical_disparity import VerticalDisparityCorrection


@frozen(eq=False)
class PreprocessedFrame:
    """A rectified frame.

    Attributes:
        index: number of the frame in its source.
        images: rectified images (H, W) uint8 by camera, None where one is missing.
        pyramid: images[0] at 1/2, 1/4 and 1/8 of its size.
        features: of each image, inside the pinhole camera's field of view; extracted when they are
            needed, since frames that do not become keyframes seldom need them.
        depth: (H, W) metres at the pixels of images[0], 0 where unknown, or None.
        path: the file that holds the image of camera 0 as recorded, or None.
        vertical_disparity: that of recorded pairs as estimated until this frame, or None.
        corrected: the part of them that is corrected in images[1].
        repetition: whether the image of camera 0 repeats the one before.
        image_fixed: what stands still in images[0] while the scene moves.
        masks: (H, W) uint8 by camera, 0 where that image is not to be used, or None.
        misled: frames before this one, to be tracked anew without such content, found just now.
        second_features: features of a second kind, of each image, where there is one.
        is_second: whether `features` and `second_features` have changed places.
    """

    index: int
    stamp_ns: int
    images: tuple[Bytes | None, ...]
    pyramid: tuple[Bytes, ...]
    features: tuple[LazyFuture[Keypoints] | None, ...]
    depth: Floats32 | None = None
    path: Path | None = None
    vertical_disparity: VerticalDisparity | None = None
    corrected: VerticalDisparity = VerticalDisparity()
    faults: tuple[Fault, ...] = ()
    repetition: Repetition = Repetition.NONE
    image_fixed: ImageFixed = ImageFixed()
    masks: tuple[Bytes | None, Bytes | None] = (None, None)
    misled: tuple[PreprocessedFrame, ...] = ()
    second_features: tuple[LazyFuture[Keypoints] | None, ...] = ()
    is_second: bool = False

    def of_kind(self, *, is_second: bool) -> PreprocessedFrame:
        """The frame with features of the second kind, or of the first."""
        if is_second == self.is_second:
            return self
        return replace(
            self,
            features=self.second_features,
            second_features=self.features,
            is_second=is_second,
        )

    @property
    def image0(self) -> Bytes:
        """The image of camera 0."""
        image = self.images[0]
        assert image is not None
        return image

    @property
    def missing_ratio(self) -> float:
        """Ratio of the rows of the image of camera 0 that are missing."""
        return sum(fault.value for fault in self.faults if fault.kind is FaultKind.MISSING_ROWS)

    @property
    def keypoints(self) -> Keypoints:
        """The features of camera 0."""
        features = self.features[0]
        assert features is not None
        return features.result()

    @property
    def used_keypoints_xy(self) -> Floats32:
        """Pixels (N, 2) of the features of camera 0; none if they were not needed."""
        features = self.features[0]
        is_used = features is not None and features.is_used
        return self.keypoints.xy if is_used else np.empty((0, 2), np.float32)

    def start_features(self) -> None:
        """Start the extraction of features in all images, in threads where there are any."""
        for features in self.features:
            if features is not None:
                features.start()

    @property
    def right(self) -> tuple[Bytes, LazyFuture[Keypoints]] | None:
        """Image and features of camera 1, None in mono or where the image is missing."""
        if len(self.images) < 2 or self.images[1] is None or self.features[1] is None:
            return None
        return self.images[1], self.features[1]

    @property
    def has_disparity(self) -> bool:
        """Whether there is a right image or measured depth."""
        return self.right is not None or self.depth is not None


# As many threads have enough to do with tracking, reading and windows.
_BUSY_THREADS = 2


class FramePreprocessor:
    """Preprocesses frames, left and right images in a thread each where there are cores for it.

    Vertical disparities of pairs are corrected on the way, see
    `vo.engine.frontend.vertical_disparity`. A right image that repeats the one before it, while the
    left one does not, is left out.

    Attributes:
        is_eager: whether features, too, are extracted a frame ahead. Features that turn out not to
            be needed cost time and change nothing else.

    Args:
        pair_check: refuses pairs whose images are exchanged; None for no check.
        masks: parts of all images that are not used; None for none.
        second: extracts features of a second kind; None if there is none.
    """

    def __init__(
        self,
        rig: RectifiedRig,
        extractor: FeatureExtractor,
        vertical_disparity: VerticalDisparityCorrection,
        pair_check: PairCheck | None = None,
        masks: StaticMasks | None = None,
        second: FeatureExtractor | None = None,
        *,
        threads: int,
    ) -> None:
        self.is_eager = True
        self._rig = rig
        self._extractor = extractor
        self._vertical_disparity = vertical_disparity
        self._pair_check = pair_check
        self._masks = masks or StaticMasks(rig)
        self._second = second
        self._repetition = RepetitionDetector()
        self._image_faults = ImageFaults()
        self._missing_rows = MissingRows()
        self._contrast = ContrastCorrection()
        self._size_faults = size_faults(rig.width * rig.height)
        self._image_fixed = ImageFixedDetector(rig.fx * rig.baseline_m)
        self._recent = RecentFrames()
        self._time_offset = TimeOffsetEstimator(rig)
        self._threads = threads
        names = ("left", "right") if threads > 1 else ()
        self._pools = [
            ThreadPoolExecutor(1, thread_name_prefix=name, initializer=give_way) for name in names
        ]

    @property
    def hidden(self) -> tuple[float, ...]:
        """Ratio of the recorded images that masks of the whole run hide, by camera."""
        return self._masks.hidden

    def submit(self, frame: Frame) -> LazyFuture[PreprocessedFrame]:
        """A frame to be preprocessed."""
        pool = self._pools[0] if self._pools else None
        return LazyFuture(lambda: self._preprocess(frame), pool)

    def ahead(self, frames: Iterable[Frame]) -> Iterator[LazyFuture[PreprocessedFrame]]:
        """All frames, with more than two threads each started while the one before it is tracked.

        With two, handing frames over takes 4 % of the CPU time and saves no wall time
        (docs/experiments/thread-scheduling.md).
        """
        if self._threads > _BUSY_THREADS:
            return each_started_early(frames, self.submit)
        self._pools = []
        return map(self.submit, frames)

    def are_exchanged(self, frame: PreprocessedFrame) -> bool:
        """Whether left and right images have changed places."""
        if self._pair_check is None or frame.right is None:
            return False
        image1, features1 = frame.right
        left, right = View(frame.image0, frame.keypoints), View(image1, features1.result())
        return self._pair_check.are_exchanged(left, right)

    def close(self) -> None:
        """End the threads."""
        for pool in self._pools:
            pool.shutdown(cancel_futures=True)

    def _preprocess(self, frame: Frame) -> PreprocessedFrame:
        images = tuple(None if image is None else usual_array(image) for image in frame.images)
        frame = replace(frame, images=images)
        left_change = self._repetition.update(frame.images)[0]
        self._image_faults.update(frame.image0)
        frame, missing = self._missing_rows.update(frame)
        faults = self._size_faults + self._image_faults.faults + missing
        if self._rig.is_metric and self._repetition.is_right_frozen:
            frame = replace(frame, images=frame.images[:1])
            faults = (
                *faults,
                Fault(FaultKind.REPEATED_RIGHT_IMAGES, is_handled=True),
            )
        frame = replace(frame, images=self._contrast.update(frame.images))
        faults += self._contrast.faults
        recorded = RecordedFrame(frame, left_change.repetition, faults)
        image0 = self._rig.rectify(frame.image0, 0)
        pyramid = half_size_pyramid(image0)
        used, matches = self._masks.left_with(frame.mask), self._vertical_disparity.matches
        fixed = self._image_fixed.update(pyramid, image0.shape, matches, used)
        misled = self._recent.add(recorded, fixed)
        if misled:
            self._vertical_disparity.restart()
            self._time_offset = TimeOffsetEstimator(self._rig)
        again = tuple(self._without_fixed(each, fixed) for each in misled)
        if self._rig.is_metric:
            self._time_offset.next_image(frame.stamp_ns, image0)
        mask = _joined(used, fixed.mask)
        preprocessed = self._preprocessed(recorded, image0, pyramid, fixed, mask, self._pair_check)
        if self.is_eager:
            preprocessed.start_features()
        return replace(preprocessed, misled=again) if again else preprocessed

    def _without_fixed(self, recorded: RecordedFrame, fixed: ImageFixed) -> PreprocessedFrame:
        image0 = self._rig.rectify(recorded.frame.image0, 0)
        mask = _joined(self._masks.left_with(recorded.frame.mask), fixed.mask)
        return self._preprocessed(recorded, image0, half_size_pyramid(image0), fixed, mask, None)

    def _preprocessed(
        self,
        recorded: RecordedFrame,
        image0: Bytes,
        pyramid: tuple[Bytes, ...],
        fixed: ImageFixed,
        mask: Bytes | None,
        pair_check: PairCheck | None,
    ) -> PreprocessedFrame:
        frame = recorded.frame
        images, features = self._images_and_features(frame, image0, mask, pair_check)
        masks = mask, self._right_mask()
        return PreprocessedFrame(
            frame.index,
            frame.stamp_ns,
            images,
            pyramid,
            features,
            None if frame.depth is None else self._rig.rectify_depth(frame.depth),
            frame.path,
            self._vertical_disparity.estimated,
            self._vertical_disparity.corrected,
            self._vertical_disparity.faults
            + self._time_offset.faults
            + fixed.faults
            + recorded.faults,
            recorded.repetition,
            fixed,
            masks,
            second_features=self._second_features(images, masks),
        )

    def _right_mask(self) -> Bytes | None:
        """The mask of camera 1 as its images are rectified now."""
        return self._masks.right(self._vertical_disparity.aligned_rig())

    def _images_and_features(
        self, frame: Frame, image0: Bytes, mask: Bytes | None, pair_check: PairCheck | None
    ) -> tuple[tuple[Bytes | None, ...], tuple[LazyFuture[Keypoints] | None, ...]]:
        rig, correction = self._rig, self._vertical_disparity
        left = LazyFuture(lambda: self._extract_left(image0, mask), self._pool_of_left())
        if not rig.is_metric or frame.image1 is None:
            return (image0,), (left,)
        image1 = correction.aligned_rig().rectify(frame.image1, 1)
        right = self._extract_right(image1)
        is_corrected, is_checked = correction.needs_next_pair(), _compare(pair_check, frame)
        if is_corrected or is_checked:
            right.start()
            # Extracted here: the thread of the left images, which this is, cannot wait for itself.
            left = finished(self._extract_left(image0, mask))
            pair = View(image0, left.result()), View(image1, right.result())
            has_changed = is_corrected and correction.update(*pair)
            if is_corrected:
                self._time_offset.add(frame.stamp_ns, correction.matches)
            if pair_check is not None:
                points = correction.points if is_corrected else None
                pair_check.update(frame.index, *pair, points)
            if has_changed:
                image1 = correction.aligned_rig().rectify(frame.image1, 1)
                right = self._extract_right(image1)
        return (image0, image1), (left, right)

    def _second_features(
        self, images: tuple[Bytes | None, ...], masks: tuple[Bytes | None, Bytes | None]
    ) -> tuple[LazyFuture[Keypoints] | None, ...]:
        """Features of the second kind, extracted only where they are needed."""
        second = self._second
        if second is None:
            return ()
        image0, mask0 = images[0], masks[0]
        assert image0 is not None
        left = LazyFuture(lambda: self._inside_lens(second.extract(image0, mask0)), None)
        if len(images) < 2 or images[1] is None:
            return (left,)
        image1, mask1 = images[1], masks[1]
        return left, LazyFuture(lambda: second.extract(image1, mask1), None)

    def _pool_of_left(self) -> ThreadPoolExecutor | None:
        """The thread for features of camera 0; with a single camera the second, idle one."""
        if not self._pools:
            return None
        return self._pools[0 if self._rig.is_metric else 1]

    def _extract_left(self, image: Bytes, mask: Bytes | None) -> Keypoints:
        # With a single camera nothing in the first thread waits for features, so that extraction,
        # in the second, may wait for the first.
        helper = self._pools[0] if self._pools and not self._rig.is_metric else None
        return self._inside_lens(self._extractor.extract(image, mask, helper))

    def _inside_lens(self, keypoints: Keypoints) -> Keypoints:
        """The features inside the pinhole camera's field of view."""
        inside = np.asarray(np.isfinite(self._rig.undistort(keypoints.xy)).all(axis=1))
        return keypoints if inside.all() else keypoints.select(inside)

    def _extract_right(self, image: Bytes) -> LazyFuture[Keypoints]:
        pool, mask = self._pools[1] if self._pools else None, self._right_mask()
        return LazyFuture(lambda: self._extractor.extract(image, mask), pool)


def _joined(mask: Bytes | None, other: Bytes | None) -> Bytes | None:
    """A mask (H, W) that hides what either of two hides."""
    if mask is None or other is None:
        return other if mask is None else mask
    return np.minimum(mask, other)


def _compare(pair_check: PairCheck | None, frame: Frame) -> bool:
    """Compare the recorded images of a pair; whether their disparities are to be checked."""
    if pair_check is None:
        return False
    is_checked = pair_check.needs_next_pair()
    pair_check.compare(frame)
    return is_checked
