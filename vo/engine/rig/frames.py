"""Frames of a rig as preprocessed views, in a thread for each core."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from vo.base.compiling.signatures import usual_array
from vo.base.faults import Fault, FaultKind
from vo.base.images.image_circle import circle_mask
from vo.base.scheduling import give_way
from vo.base.types import Bytes, Frame, Keypoints
from vo.engine.frontend.camera_alignment import half_size_pyramid
from vo.engine.frontend.contracts import FeatureExtractor
from vo.engine.frontend.contrast import ContrastCorrection, has_content
from vo.engine.frontend.image_repetition import Repetition, image_change, rig_repetition
from vo.engine.frontend.lazy_future import LazyFuture, each_started_early
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.rig.views import RigViews

_MIN_MOVING_PX = 0.4  # motion in another camera from which one that repeats its image has frozen


@dataclass(frozen=True, eq=False)
class RigFrame:
    """A frame of V views.

    Attributes:
        views: of all cameras; black where an image is missing.
        used: (V,) whether a view may be used.
        delay_s: (V,) time of each view after that of the frame.
    """

    index: int
    stamp_ns: int
    views: tuple[PreprocessedFrame, ...]
    used: tuple[bool, ...]
    delay_s: tuple[float, ...]
    faults: tuple[Fault, ...] = ()

    def start_features(self) -> None:
        """Start the extraction of features in all views, in threads where there are any."""
        for view in self.views:
            view.start_features()


class RigPreprocessor:
    """Rectifies the images of a rig, and leaves out cameras that are missing, dark or frozen."""

    def __init__(self, rig: RigViews, extractor: FeatureExtractor, threads: int) -> None:
        self.is_eager = True
        self._rig = rig
        self._masks = [view.mask for view in rig.views]
        self._circles: set[int] = set()  # views whose image circle was looked for
        self._extractor = extractor
        self._before: tuple[Bytes | None, ...] = ()
        self._contrast = [ContrastCorrection() for _ in range(1 + rig.views[-1].camera)]
        names = ("frame", "views") if threads > 1 else ()
        workers = max(1, min(threads - 1, len(rig.views)))
        self._pools = [
            ThreadPoolExecutor(count, thread_name_prefix=name, initializer=give_way)
            for name, count in zip(names, (1, workers), strict=False)
        ]

    def submit(self, frame: Frame) -> LazyFuture[RigFrame]:
        """A frame to be preprocessed."""
        return LazyFuture(lambda: self._preprocess(frame), self._pools[0] if self._pools else None)

    def ahead(self, frames: Iterable[Frame]) -> Iterator[LazyFuture[RigFrame]]:
        """All frames, each started while the one before it is tracked."""
        return each_started_early(frames, self.submit)

    def close(self) -> None:
        """End the threads."""
        for pool in self._pools:
            pool.shutdown(cancel_futures=True)

    def _preprocess(self, frame: Frame) -> RigFrame:
        cameras = 1 + max(view.camera for view in self._rig.views)
        given = (*frame.images, *(None,) * cameras)[:cameras]
        images = tuple(None if each is None else usual_array(each) for each in given)
        left_out, repetition = self._left_out(images)
        clear = [
            None if image is None else contrast.update((image,))[0]
            for image, contrast in zip(images, self._contrast, strict=True)
        ]
        self._hide_surround(images)
        shown = [self._view(frame, clear[view.camera], n) for n, view in enumerate(self._rig.views)]
        views = tuple(replace(view, repetition=repetition) for view in shown)
        used = tuple(not left_out[view.camera] for view in self._rig.views)
        stamps_ns = frame.stamps_ns or (frame.stamp_ns,) * cameras
        delay_s = tuple(1e-9 * (stamps_ns[v.camera] - frame.stamp_ns) for v in self._rig.views)
        out = [f"cam{number}" for number, is_out in enumerate(left_out) if is_out]
        fault = Fault(FaultKind.CAMERA_LEFT_OUT, any(used), len(out), ", ".join(out))
        faults = (fault,) if out else ()
        result = RigFrame(frame.index, frame.stamp_ns, views, used, delay_s, faults)
        if self.is_eager:
            result.start_features()
        return result

    def _left_out(self, images: Sequence[Bytes | None]) -> tuple[list[bool], Repetition]:
        """Whether each camera gives no image, one without content, or the one before again.

        And whether all those that give one with content repeat it.
        """
        shown = [i if i is not None and has_content(i) else None for i in images]
        before = self._before or (None,) * len(images)
        self._before = tuple(images)
        changes = [image_change(*pair) for pair in zip(before, images, strict=True)]
        is_moving = any(each.motion_px > _MIN_MOVING_PX for each in changes)
        left_out = [
            image is None or (is_moving and change.repetition is Repetition.IDENTICAL)
            for image, change in zip(shown, changes, strict=True)
        ]
        return left_out, rig_repetition(before, shown, changes)

    def _hide_surround(self, images: Sequence[Bytes | None]) -> None:
        """Find the circles of wide lenses in their first images."""
        for number, view in enumerate(self._rig.views):
            image = images[view.camera]
            if image is None or view.lens is None or number in self._circles:
                continue
            self._circles.add(number)
            circle = circle_mask(image, view.lens)
            mask, before = None if circle is None else view.mask_of(circle), self._masks[number]
            if mask is not None:
                self._masks[number] = mask if before is None else np.minimum(mask, before)

    def _view(self, frame: Frame, image: Bytes | None, number: int) -> PreprocessedFrame:
        rig, view = self._rig.rectified, self._rig.views[number]
        shown = (
            np.zeros((rig.height, rig.width), np.uint8) if image is None else view.rectify(image)
        )
        mask = self._masks[number]
        if view.camera == 0 and frame.mask is not None:
            of_frame = view.rectify(frame.mask)
            mask = of_frame if mask is None else np.minimum(mask, of_frame)

        def extract() -> Keypoints:
            return self._extractor.extract(shown, mask)

        features = LazyFuture(extract, self._pools[1] if self._pools else None)
        return PreprocessedFrame(
            frame.index,
            frame.stamp_ns,
            (shown,),
            half_size_pyramid(shown),
            (features,),
            path=frame.path if view.camera == 0 else None,
            masks=(mask, None),
        )
