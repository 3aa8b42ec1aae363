"""A source of images listed beforehand and read one by one, when they are asked for.

It serves every container: what it is given are `StoredImage`s (`vo.sources.images`), which it reads
a few frames ahead, one thread for each camera.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from typing import NamedTuple, TypeVar, cast

import numpy as np

from vo.errors import SourceError
from vo.scheduling import give_way
from vo.sources.depth import DepthImages, read_depth
from vo.sources.images import ImageFile, ImageKind, Pixels, StoredImage, read_image
from vo.sources.imu import Imu
from vo.sources.listing import Shot
from vo.types import Bytes, Camera, Floats32, Frame, Ints, Rig, Skipped, Trajectory

_log = logging.getLogger(__name__)

_Image = Future[Pixels]
_Depth = Future[Floats32]
_Result = TypeVar("_Result")
_FRAMES_AHEAD = 2

FrameImages = tuple[Shot, StoredImage | None]
"""The left image of a frame and the right one, if there is one."""


class ListedImages(NamedTuple):
    """The images of a recording.

    Attributes:
        left: images of cam0 in time order.
        right: the partner of each, None where it is missing; None in mono.
        depth_bits: number of bits that the camera uses, of images with 16 bits per pixel.
        depth: the depth of each image of cam0, None without a depth camera.
    """

    left: Sequence[Shot]
    right: Sequence[StoredImage | None] | None = None
    depth_bits: int = 16
    depth: DepthImages | None = None


class ImageSequence:
    """The `Source` of every format whose images can be listed beforehand.

    Attributes:
        name: short name for titles and file names.
        format: name of the format in the registry.
        rig: the cameras, cam1 only if the frames have an image1.
        ground_truth: true poses of cam0, or None where the recording has none.
        skipped: frames that the newest call of `frames` could not hand out so far, and why.
        unpaired: frames that it handed out without their image1 so far, in stereo.
        imus: inertial sensors, the one to use first.
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
        """Take the images that a format has listed.

        Args:
            name: short name for titles and file names.
            format: name of the format in the registry.
            rig: the cameras.
            images: the images of all cameras.
            ground_truth: true poses of cam0.
            close: closes files that images keep open between reads; they may be read again.
            imus: inertial sensors, the preferred one first.
        """
        self.name = name
        self.format = format
        self.rig = rig
        self.ground_truth = ground_truth
        self.skipped: list[Skipped] = []
        self.unpaired = 0
        self.imus = tuple(imus)
        self._left = list(images.left)
        self._right = None if images.right is None else list(images.right)
        self._depth_bits = images.depth_bits
        self._depth = images.depth
        self._close = close
        self._more: Callable[[], list[FrameImages] | None] | None = None

    def __len__(self) -> int:
        """Number of frames before slicing, those that cannot be read included."""
        return len(self._left)

    @property
    def stamps_ns(self) -> Ints:
        """(N,) the time of every frame before slicing."""
        return np.array([shot.stamp_ns for shot in self._left], dtype=np.int64)

    def frames(
        self,
        start: int = 0,
        end: int | None = None,
        stride: int = 1,
        images: ImageKind = "grey",
    ) -> Iterator[Frame]:
        """Read frames start, start + stride, … below end.

        Those that cannot be read are warned of, noted in `skipped` and left out.

        Args:
            start: first frame.
            end: frame to stop before; None for the last.
            stride: take every so many frames.
            images: what to read them as.

        Raises:
            SourceError: the numbers choose no frame.
        """
        if self._more is not None:
            choose_frames(start + 1, start, end, stride)
            return self._read(self._arriving(self._more, start, end, stride), images)
        numbers = choose_frames(len(self), start, end, stride)
        return self._read(numbers, images)

    def begin_anew(self, more: Callable[[], list[FrameImages] | None]) -> None:
        """Drop all frames and take those that come while they are read.

        Args:
            more: waits for the next frames; None when there will be no more.
        """
        if self.rig.has_depth:
            self.rig = Rig(self.rig.cam0)  # depth does not come along
        self.imus = ()
        self.ground_truth = None  # no more than its beginning could be known
        self._left, self._depth = [], None
        self._right = [] if self.rig.is_stereo else None
        self._more = more

    def _arriving(
        self, more: Callable[[], list[FrameImages] | None], start: int, end: int | None, stride: int
    ) -> Iterator[int]:
        index = start
        while end is None or index < end:
            while index >= len(self._left):
                new = more()
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
            cam0, cam1 = (stack.enter_context(_reader(name)) for name in ("cam0", "cam1"))
            for index, image0, image1, image2 in self._ahead(cam0, cam1, numbers, kind):
                shot = self._left[index]
                try:
                    left = image0.result()
                except SourceError as error:
                    _log.warning("frame %d skipped: %s", index, error)
                    self.skipped.append(Skipped(index, shot.stamp_ns, str(error)))
                    continue
                right, depth = _partner(index, image1, "right"), _partner(index, image2, "depth")
                if right is None and depth is None and self.rig.is_metric:
                    self.unpaired += 1
                path = shot.image.path if isinstance(shot.image, ImageFile) else None
                pair = cast("tuple[Bytes, Bytes | None]", (left, right))  # 16 bits if asked for
                yield Frame(index, shot.stamp_ns, pair, depth, path)

    def _ahead(
        self,
        cam0: ThreadPoolExecutor,
        cam1: ThreadPoolExecutor,
        numbers: Iterable[int],
        kind: ImageKind,
    ) -> Iterator[tuple[int, _Image, _Image | None, _Depth | None]]:
        """Decode the next frames while this one is worked on: OpenCV leaves Python's lock free."""
        waiting: deque[tuple[int, _Image, _Image | None, _Depth | None]] = deque()
        for index in numbers:
            left = cam0.submit(self._image, self._left[index].image, self.rig.cam0, kind)
            partner = None if self._right is None else self._right[index]
            right = None
            if partner is not None and self.rig.cam1 is not None:
                right = cam1.submit(self._image, partner, self.rig.cam1, kind)
            measured = None if self._depth is None else self._depth.images[index]
            depth = None if measured is None else cam1.submit(self._metres, measured)
            waiting.append((index, left, right, depth))
            if len(waiting) > _FRAMES_AHEAD:
                yield waiting.popleft()
        yield from waiting

    def _image(self, stored: StoredImage, camera: Camera, kind: ImageKind) -> Pixels:
        image = read_image(stored, kind, self._depth_bits)
        _check_size(stored, image.shape, camera)
        return image

    def _metres(self, stored: StoredImage) -> Floats32:
        assert self._depth is not None
        depth = read_depth(stored, self._depth.per_metre)
        _check_size(stored, depth.shape, self.rig.cam0)
        return depth


def _reader(camera: str) -> ThreadPoolExecutor:
    """A thread of its own for a camera, so that containers that run one way are read in order."""
    return ThreadPoolExecutor(1, thread_name_prefix=f"read-{camera}", initializer=give_way)


def _check_size(stored: StoredImage, shape: tuple[int, ...], camera: Camera) -> None:
    height, width = shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise SourceError(
            f"image {stored.name} is {width}x{height}, but the camera gives "
            f"{camera.width}x{camera.height}"
        )


def _partner(index: int, image: Future[_Result] | None, kind: str) -> _Result | None:
    try:
        return None if image is None else image.result()
    except SourceError as error:
        _log.warning("frame %d used without its %s image: %s", index, kind, error)
        return None


def choose_frames(length: int, start: int, end: int | None, stride: int) -> range:
    """The frame numbers start, start + stride, … below end and `length`.

    Raises:
        SourceError: a number is negative, the stride not positive, or none is left.
    """
    if stride < 1:
        raise SourceError(f"stride is {stride}; it must be 1 or more")
    if start < 0 or (end is not None and end < 0):
        raise SourceError(f"start is {start} and end {end}; frame numbers begin at 0")
    if start >= length:
        raise SourceError(f"start is {start}, but the recording has only {length} frames")
    if end is not None and end <= start:
        raise SourceError(f"end is {end}, not after start {start}: no frame is left")
    return range(start, length if end is None else min(end, length), stride)
