"""Images that contain the left and the right image of a stereo camera beside each other."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from vo.base.errors import SourceError
from vo.base.frozen import frozen
from vo.recordings.sources.assembly import RecordingContents
from vo.recordings.sources.images import Pixels, StoredImage

_KEPT = 16  # decoded images: the readers of both halves are a few frames apart

_Type = TypeVar("_Type", bound=np.generic)


def halves(image: NDArray[_Type], name: str) -> tuple[NDArray[_Type], NDArray[_Type]]:
    """The left and the right half of an image."""
    width = image.shape[1]
    if width % 2:
        raise SourceError(f"{name} is {width} pixels wide: it has no two halves of equal width")
    left, right = image[:, : width // 2], image[:, width // 2 :]
    return np.ascontiguousarray(left), np.ascontiguousarray(right)


def split_side_by_side(contents: RecordingContents) -> RecordingContents:
    """A recording of side-by-side images as one of stereo pairs."""
    if contents.right:
        raise SourceError(f"{contents.name} has right images of its own; leave `side_by_side` out")
    whole = _DecodedOnce([shot.image for shot in contents.left])
    left, right = (
        [
            shot._replace(image=_Half(whole, number, side))
            for number, shot in enumerate(contents.left)
        ]
        for side in range(2)
    )
    return replace(contents, left=left, right=right)


def not_side_by_side(path: Path, format: str) -> SourceError:
    """The error for recordings of other formats than images and videos."""
    return SourceError(
        f"{path} ({format}) is a log: `side_by_side` is for videos and folders of images"
    )


class _DecodedOnce:
    """Images that two threads read, decoded once each; `StoredImage` asks for one reader."""

    def __init__(self, images: Sequence[StoredImage]) -> None:
        self.images = images
        self._lock = threading.Lock()
        self._decoded: OrderedDict[tuple[int, bool], Pixels] = OrderedDict()

    def read(self, number: int, colour: bool) -> Pixels:
        with self._lock:
            key = (number, colour)
            if key not in self._decoded:
                self._decoded[key] = self.images[number].read(colour)
                while len(self._decoded) > _KEPT:
                    self._decoded.popitem(last=False)
            return self._decoded[key]


@frozen()
class _Half:
    """One half of a stored image."""

    whole: _DecodedOnce
    number: int
    side: int

    @property
    def name(self) -> str:
        """Name of the whole image."""
        return self.whole.images[self.number].name

    def read(self, colour: bool = False) -> Pixels:
        """See `StoredImage.read`."""
        return halves(self.whole.read(self.number, colour), f"image {self.name}")[self.side]
