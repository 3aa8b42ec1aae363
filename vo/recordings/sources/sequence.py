"""Recordings whose images are listed beforehand and decoded a few frames ahead.

Works for every container, because images are `StoredImage`s (`vo.recordings.sources.images`); each
camera has one decoding thread.
"""

from __future__ import annotations

import logging
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from typing import NamedTuple, TypeVar, cast

import numpy as np

from vo.base.errors import SourceError
from vo.base.faults import Fault
from vo.base.printable import counted
from vo.base.scheduling import give_way
from vo.base.types import Bytes, Camera, Floats32, Frame, Ints, Rig, Skipped, Trajectory
from vo.recordings.sources.depth import DepthImages, read_depth
from vo.recordings.sources.grey_levels import GreyLevels
from vo.recordings.sources.images import ImageFile, ImageKind, Pixels, StoredImage
from vo.recordings.sources.imu import Imu
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.rig_frames import MissingImage

_log = logging.getLogger(__name__)

_Image = Future[Pixels]
_Depth = Future[Floats32]
_Decoding = tuple[int, _Image, list[_Image | None], _Depth | None]
_Result = TypeVar("_Result")
_FRAMES_AHEAD = 2

FrameImages = tuple[Shot, StoredImage | None]
"""The left image of a frame, and the right one or None."""


class ListedImages(NamedTuple):
    """The images of a recording.

    Attributes:
        right: right image of each, None where it is missing; None in mono.
        further: the same of cam2, cam3 and so on.
        stamps_ns: of each, the times of the images by camera; None with a common trigger.
        camera_stamps_ns: of all cameras of a rig, (N,) the recorded times of their images, -1
            without one; empty for one camera or a pair, whose frames all have a left image.
    """

    left: Sequence[Shot]
    right: Sequence[StoredImage | None] | None = None
    levels: GreyLevels = GreyLevels()
    depth: DepthImages | None = None
    further: Sequence[Sequence[StoredImage | None]] = ()
    stamps_ns: Sequence[tuple[int, ...]] | None = None
    camera_stamps_ns: Sequence[Ints] = ()


class ImageSequence:
    """A `Recording` whose images are listed beforehand.

    Attributes:
        rig: the cameras, cam1 only if the frames have an image1.
        skipped: unreadable frames of the latest call of `frames` so far, with reasons.
        unpaired: number of its frames so far without depth or all images, if the rig has more
            than one camera or depth.
        right_offset_ns: added to the stamps of right images before they were paired.
        image_stamps_ns: of each frame the times of its images; None with a common trigger.
        camera_stamps_ns: see `ListedImages`.
        rescale: applied to each frame, see `vo.recordings.sources.rescaling`.
    """

    def __init__(
        self,
        name: str,
        format: str,
        rig: Rig,
        images: ListedImages,
        *,
        ground_truth: Trajectory | None,
        close: Callable[[], None] | None = None,
        imus: Sequence[Imu] = (),
    ) -> None:
        """Store the listed images.

        `close`: closes the files that images keep open between reads; they can be read again.
        """
        self.name = name
        self.format = format
        self.rig = rig
        self.ground_truth = ground_truth
        self.skipped: list[Skipped] = []
        self.unpaired = 0
        self.imus = tuple(imus)
        self.faults: list[Fault] = []
        self.right_offset_ns = 0
        self._left = list(images.left)
        self._right = None if images.right is None else list(images.right)
        self._further = images.further
        self.image_stamps_ns = images.stamps_ns
        self.camera_stamps_ns = images.camera_stamps_ns
        self._levels = images.levels
        self._depth = images.depth
        self._close = close
        self._next_frames: Callable[[], list[FrameImages] | None] | None = None
        self.rescale: Callable[[Frame], Frame] | None = None

    def __len__(self) -> int:
        """Number of frames before slicing, including unreadable ones."""
        return len(self._left)

    @property
    def first_image(self) -> StoredImage:
        """The first image of cam0, as stored."""
        own_ns = [*self.camera_stamps_ns, self.stamps_ns][0]
        return self._left[int(np.argmax(own_ns >= 0))].image

    @property
    def stamps_ns(self) -> Ints:
        """(N,) stamps of all frames before slicing."""
        return np.array([shot.stamp_ns for shot in self._left], dtype=np.int64)

    def frames(
        self, start: int = 0, end: int | None = None, stride: int = 1, images: ImageKind = "grey"
    ) -> Iterator[Frame]:
        """Read frames start, start + stride, … below end.

        Unreadable frames are left out, with a warning and an entry in `skipped`. Those of a rig
        may have the images of other cameras only, see `vo.base.types.with_image0`.
        """
        if self._next_frames is not None:
            select_frames(start + 1, start, end, stride)
            return self._read(self._arriving(self._next_frames, start, end, stride), images)
        numbers = select_frames(len(self), start, end, stride)
        return self._read(numbers, images)

    def follow(self, next_frames: Callable[[], list[FrameImages] | None]) -> None:
        """Drop all listed frames, and read frames as they arrive instead.

        Depth, inertial sensors and ground truth are dropped as well: they cannot be followed.

        Args:
            next_frames: waits for the next frames and returns them; None at the end.
        """
        if self.rig.has_depth:
            self.rig = Rig(self.rig.cam0)
        self.imus = ()
        self.ground_truth = None
        self._left, self._depth = [], None
        self._right = [] if self.rig.is_stereo else None
        self._next_frames = next_frames

    def _arriving(
        self,
        next_frames: Callable[[], list[FrameImages] | None],
        start: int,
        end: int | None,
        stride: int,
    ) -> Iterator[int]:
        """The numbers of frames, as soon as each has arrived."""
        index = start
        while end is None or index < end:
            while index >= len(self._left):
                new = next_frames()
                if new is None:
                    return
                self._left.extend(shot for shot, _ in new)
                if self._right is not None:
                    self._right.extend(partner for _, partner in new)
            yield index
            index += stride

    def _read(self, numbers: Iterable[int], kind: ImageKind) -> Iterator[Frame]:
        self.skipped = []
        self.unpaired = 0
        with ExitStack() as stack:
            if self._close is not None:
                stack.callback(self._close)
            names = (f"cam{number}" for number in range(max(2, len(self.rig.cameras))))
            readers = [stack.enter_context(_reader(name)) for name in names]
            losses = stack.enter_context(_Losses())
            for index, image0, others, measured in self._prefetch(readers, numbers, kind):
                shot = self._left[index]
                try:
                    images = self._images_of(index, image0, others, losses)
                except SourceError as error:
                    losses.add("skipped", index, error)
                    self.skipped.append(Skipped(index, shot.stamp_ns, str(error)))
                    continue
                depth = losses.result(measured, "used without its depth image", index)
                if depth is None and self.rig.is_metric and any(each is None for each in images):
                    self.unpaired += 1
                path = shot.image.path if isinstance(shot.image, ImageFile) else None
                # Images of kind `recorded` may be uint16.
                recorded = cast("tuple[Bytes | None, ...]", images)
                stamps = None if self.image_stamps_ns is None else self.image_stamps_ns[index]
                frame = Frame(index, shot.stamp_ns, recorded, depth, path, stamps_ns=stamps)
                yield frame if self.rescale is None else self.rescale(frame)

    def _images_of(
        self, index: int, image0: _Image, others: Sequence[_Image | None], losses: _Losses
    ) -> tuple[Pixels | None, ...]:
        """The images of a frame; raises `SourceError` if it cannot be used."""
        left, reason = None, None
        try:
            left = image0.result()
        except SourceError as error:
            reason = error
            if not self.camera_stamps_ns:
                raise
        images = [
            losses.result(image, f"used without its {name} image", index)
            for image, name in zip(others, self._names(), strict=True)
        ]
        if reason is not None:
            if all(each is None for each in images):
                raise reason
            if not isinstance(self._left[index].image, MissingImage):
                losses.add("used without its cam0 image", index, reason)
        return left, *images

    def _names(self) -> list[str]:
        """What cam1 and the further cameras are called."""
        further = [f"cam{number}" for number in range(2, len(self._further) + 2)]
        return ["cam1" if self.camera_stamps_ns else "right", *further]

    def _prefetch(
        self,
        readers: Sequence[ThreadPoolExecutor],
        numbers: Iterable[int],
        kind: ImageKind,
    ) -> Iterator[_Decoding]:
        """Decode the next frames while this one is processed; OpenCV releases the GIL."""
        waiting: deque[_Decoding] = deque()
        cam0, cameras = self.rig.cam0, self.rig.cameras[1:] or (None,)
        for index in numbers:
            left = readers[0].submit(self._image, index, self._left[index].image, cam0, kind)
            partners = [None if self._right is None else self._right[index]]
            partners += [images[index] for images in self._further]
            others = [
                None
                if stored is None or camera is None
                else reader.submit(self._image, index, stored, camera, kind)
                for reader, stored, camera in zip(readers[1:], partners, cameras, strict=True)
            ]
            measured = None if self._depth is None else self._depth.images[index]
            depth = None if measured is None else readers[1].submit(self._metres, measured)
            waiting.append((index, left, others, depth))
            if len(waiting) > _FRAMES_AHEAD:
                yield waiting.popleft()
        yield from waiting

    def _image(self, index: int, stored: StoredImage, camera: Camera, kind: ImageKind) -> Pixels:
        image = stored.read(colour=kind != "grey")
        _check_size(stored, image.shape, camera)
        return image if kind == "recorded" else self._levels.to_8_bits(image, index)

    def _metres(self, stored: StoredImage) -> Floats32:
        assert self._depth is not None
        depth = read_depth(stored, self._depth.per_metre)
        _check_size(stored, depth.shape, self.rig.cam0)
        return depth


def _reader(camera: str) -> ThreadPoolExecutor:
    """A decoding thread for one camera, so that its images are read in the recorded order."""
    return ThreadPoolExecutor(1, thread_name_prefix=f"read-{camera}", initializer=give_way)


def _check_size(stored: StoredImage, shape: tuple[int, ...], camera: Camera) -> None:
    height, width = shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise SourceError(
            f"image {stored.name} is {width}x{height}, but those of the camera are "
            f"{camera.width}x{camera.height}"
        )


class _Losses:
    """Warns of the first image that cannot be read for each reason, and counts the others."""

    def __init__(self) -> None:
        self._frames: dict[tuple[str, str], list[int]] = {}

    def __enter__(self) -> _Losses:
        return self

    def __exit__(self, *_: object) -> None:
        for frames in self._frames.values():
            if len(frames) > 1:
                _log.warning(
                    "the same for %d more frames as for frame %d, up to frame %d",
                    len(frames) - 1,
                    frames[0],
                    frames[-1],
                )

    def add(self, what: str, index: int, error: SourceError) -> None:
        """Add a frame that has lost an image; `what` is what becomes of it."""
        reason = re.sub(r"\S*[\d/]\S*", "", str(error))  # without names and numbers
        frames = self._frames.setdefault((what, reason), [])
        if not frames:
            _log.warning("frame %d %s: %s", index, what, error)
        frames.append(index)

    def result(self, image: Future[_Result] | None, what: str, index: int) -> _Result | None:
        """The image; None if there is none or it cannot be read."""
        try:
            return None if image is None else image.result()
        except SourceError as error:
            self.add(what, index, error)
            return None


def select_frames(length: int, start: int, end: int | None, stride: int) -> range:
    """The frame numbers start, start + stride, … below end and `length`."""
    if stride < 1:
        raise SourceError(f"stride is {stride}; it must be 1 or more")
    if start < 0 or (end is not None and end < 0):
        raise SourceError(f"start is {start} and end {end}; frame numbers begin at 0")
    if start >= length:
        raise SourceError(
            f"start is {start}, but the recording has only {counted(length, 'frame')}"
        )
    if end is not None and end <= start:
        raise SourceError(f"end is {end}, not after start {start}: no frame is selected")
    return range(start, length if end is None else min(end, length), stride)
