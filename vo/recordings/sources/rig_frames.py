"""Frames of a rig: which images of its cameras belong together, whichever of them is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.errors import SourceError
from vo.base.frozen import frozen
from vo.base.types import Ints
from vo.recordings.sources.images import Pixels, StoredImage
from vo.recordings.sources.listing import Shot, median_interval_ns
from vo.recordings.sources.pairing import MAX_TOLERANCE_NS, nearest

_COMMON_TRIGGER_NS = 1_000_000
_GAP = 0.7  # intervals to the nearest frame, from which on an image is one of a further frame
_USUAL = 0.25  # quantile of the intervals of camera 0: it may have lost many images
_MIN_SHARED = 0.5  # ratio of the images that belong to frames of the others, by clocks that agree


@frozen()
class MissingImage:
    """In place of an image of camera 0 that a frame of other cameras has not."""

    name: str = "of cam0"

    def read(self, colour: bool = False) -> Pixels:
        """Raises `SourceError`."""
        raise SourceError("there is no image of cam0 at this time")


class RigFrames(NamedTuple):
    """Frames in time order.

    Attributes:
        first: images of camera 0, where it has none a `MissingImage` at the time it should have.
        others: of each other camera the images, None where one is missing.
        stamps_ns: of all cameras (N,) the times of the images, -1 without one.
        is_staggered: whether any camera differs by more than 1 ms from the first in most frames.
    """

    first: list[Shot]
    others: list[list[StoredImage | None]]
    stamps_ns: list[Ints]
    is_staggered: bool


def rig_frames(first: Sequence[Shot], others: Sequence[Sequence[Shot]]) -> RigFrames:
    """Put the images of a rig together to frames.

    Images belong to a frame if they are mutual nearest neighbours in time and differ by at most
    half the median interval of the first camera. Frames are at the images of the first camera and,
    where it has a gap, at the times at which it should have one, by the images of another camera.
    """
    own_ns = np.array([shot.stamp_ns for shot in first], np.int64)
    cameras_ns = [np.array([shot.stamp_ns for shot in shots], np.int64) for shots in others]
    most_ns = median_interval_ns(own_ns.tolist()) // 2 or MAX_TOLERANCE_NS
    frames_ns = own_ns
    for camera_ns in cameras_ns:
        frames_ns = np.union1d(frames_ns, _in_gaps(frames_ns, own_ns, camera_ns, most_ns))
    has_first = np.isin(frames_ns, own_ns)
    shots = iter(first)
    frames = [
        next(shots) if has else Shot(stamp, MissingImage(), "other cameras")
        for stamp, has in zip(frames_ns.tolist(), has_first, strict=True)
    ]
    images: list[list[StoredImage | None]] = []
    times, is_staggered = [np.where(has_first, frames_ns, -1)], False
    for camera, camera_ns in zip(others, cameras_ns, strict=True):
        rows = _rows(frames_ns, camera_ns, most_ns)
        images.append([None if row < 0 else camera[row].image for row in rows.tolist()])
        found = rows >= 0
        times.append(np.where(found, camera_ns[rows] if len(camera_ns) else -1, -1))
        apart = np.abs(times[-1] - frames_ns)[found & has_first]
        is_staggered |= bool(len(apart)) and float(np.median(apart)) > _COMMON_TRIGGER_NS
    return RigFrames(frames, images, times, is_staggered)


def _rows(frames_ns: Ints, camera_ns: Ints, most_ns: int) -> Ints:
    """(N,) the image of each frame, -1 where there is none."""
    if not len(camera_ns):
        return np.full_like(frames_ns, -1)
    of_frame, of_image = nearest(frames_ns, camera_ns), nearest(camera_ns, frames_ns)
    is_close = np.abs(camera_ns[of_frame] - frames_ns) <= most_ns
    is_mutual = of_image[of_frame] == np.arange(len(frames_ns))
    return np.asarray(np.where(is_close & is_mutual, of_frame, -1))


def _in_gaps(frames_ns: Ints, own_ns: Ints, camera_ns: Ints, most_ns: int) -> Ints:
    """Times at which camera 0 should have images, by another camera's images far from all frames.

    None if the clocks of both do not agree: while both have images these must belong together.
    """
    rows = _rows(frames_ns, camera_ns, most_ns)
    found = rows >= 0
    if len(own_ns) < 2 or not found.any():
        return np.empty(0, np.int64)
    both = min(_count_within(frames_ns, camera_ns), _count_within(camera_ns, frames_ns))
    if np.count_nonzero(found) < _MIN_SHARED * both:
        return np.empty(0, np.int64)
    late_ns = int(np.median(camera_ns[rows[found]] - frames_ns[found]))
    due_ns = camera_ns - late_ns
    apart = np.abs(due_ns - frames_ns[nearest(due_ns, frames_ns)])
    least_ns = _GAP * float(np.quantile(np.diff(own_ns), _USUAL, method="lower"))
    added: list[int] = []
    for stamp in due_ns[apart > least_ns].tolist():
        if not added or stamp - added[-1] > least_ns:  # the camera may have a higher rate
            added.append(stamp)
    return np.array(added, np.int64)


def _count_within(stamps_ns: Ints, span_ns: Ints) -> int:
    """Number of stamps between the first and the last of others."""
    return int(np.count_nonzero((stamps_ns >= span_ns[0]) & (stamps_ns <= span_ns[-1])))
