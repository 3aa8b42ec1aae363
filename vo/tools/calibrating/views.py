"""Detection of the board in a recording, and choice of the views to calibrate with."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice, pairwise

import cv2
import numpy as np

from vo.base.types import Bytes, Floats, Frame
from vo.tools.calibrating.board import Board
from vo.tools.calibrating.detection import Detection, detect

_MAX_PENDING = 6
"""Frames that are read ahead of the detection."""

_SHRINK = 4
_MIN_SHARPNESS = 0.6
"""Relative to the median sharpness; blurrier views are left out."""

_MIN_DIFFERENCE = 0.02
"""Smallest difference between outlines of two views, relative to the image's longer side."""


@dataclass(frozen=True, eq=False)
class View:
    """A frame in which the board is seen."""

    frame: int  # frame number in the recording
    stamp_ns: int
    # The board in camera 0 and camera 1; None where it is not found
    detections: tuple[Detection | None, ...]


@dataclass(frozen=True, eq=False)
class DetectedViews:
    """All views of the board in a recording."""

    frames: int  # number of frames searched
    cameras: int  # number of cameras, 1 or 2
    views: tuple[View, ...]  # frames in which at least one camera sees the board, in order

    def seen_by(self, camera: int) -> list[View]:
        """Views in which a camera sees the board."""
        return [view for view in self.views if view.detections[camera] is not None]


def detect_views(
    board: Board,
    frames: Iterable[Frame],
    cameras: int,
    threads: int,
    progress: Callable[[int, int], None] = lambda searched, found: None,
) -> DetectedViews:
    """Search all frames for the board.

    `cameras`: number of cameras, 1 or 2. `threads`: number of threads; the result does not depend
    on it. `progress`: called after each frame with the numbers of frames searched and of views.
    """
    views: list[View] = []
    searched = 0
    for view in _searched(board, frames, cameras, threads):
        searched += 1
        if any(each is not None for each in view.detections):
            views.append(view)
        progress(searched, len(views))
    return DetectedViews(searched, cameras, tuple(views))


def least_motion_frames(frames: Iterable[Frame], group_size: int) -> Iterator[Frame]:
    """The frame with the least motion of each group of consecutive frames.

    Without motion, images are sharp, free of rolling-shutter distortion, and consistent between
    two cameras that do not expose at the same moment.
    """
    rest = iter(frames)
    while group := list(islice(rest, group_size)):
        paired = [frame for frame in group if frame.image1 is not None]
        yield _least_motion(paired or group)


def _least_motion(group: Sequence[Frame]) -> Frame:
    if len(group) == 1:
        return group[0]
    size = [max(side // _SHRINK, 1) for side in group[0].image0.shape[::-1]]
    small = [cv2.resize(frame.image0, size, interpolation=cv2.INTER_AREA) for frame in group]
    changes = [float(np.mean(cv2.absdiff(a, b))) for a, b in pairwise(small)]
    # The larger change of both neighbours: a copy of the previous frame may be in motion.
    motion = [max(changes[max(i - 1, 0) : i + 1]) for i in range(len(group))]
    return group[int(np.argmin(motion))]


def _searched(board: Board, frames: Iterable[Frame], cameras: int, threads: int) -> Iterator[View]:
    pending: deque[tuple[Frame, list[Future[Detection | None] | None]]] = deque()
    with ThreadPoolExecutor(max_workers=max(threads, 1)) as pool:
        for frame in frames:
            images: list[Bytes | None] = [frame.image0, frame.image1][:cameras]
            jobs = [
                None if image is None else pool.submit(detect, board, image) for image in images
            ]
            pending.append((frame, jobs))
            if len(pending) > _MAX_PENDING:
                yield _finished(*pending.popleft())
        while pending:
            yield _finished(*pending.popleft())


def _finished(frame: Frame, jobs: list[Future[Detection | None] | None]) -> View:
    found = [None if job is None else job.result() for job in jobs]
    if len(found) == 2 and found[0] is not None and found[1] is not None:
        found[1] = _ordered_like(found[0], found[1])
    return View(frame.index, frame.stamp_ns, tuple(found))


def _ordered_like(left: Detection, right: Detection) -> Detection:
    """The right detection, with its corners in the order of the left one.

    A chessboard looks the same after half a turn, so corners may be numbered from either end.
    """
    if len(left.ids) != len(right.ids) or not np.array_equal(left.ids, right.ids):
        return right
    shape = left.outline - left.outline.mean(axis=0)
    other = right.outline - right.outline.mean(axis=0)
    if np.sum(shape * other) >= 0.0:
        return right
    return Detection(right.ids, right.xy[::-1], right.outline[[2, 3, 0, 1]], right.sharpness)


def choose_views(views: Sequence[View], max_count: int, size: tuple[int, int]) -> list[View]:
    """Choose the most different of the sharp views, in order (farthest-point sampling).

    A view is described by the pixels of the outermost corners of the board, which depend on its
    position, distance, tilt and rotation. The first view is the sharpest; each further view is the
    one farthest from all chosen ones, until the rest does not differ.

    `views`: the candidates, all with detections in the same cameras. `max_count`: largest number of
    views. `size`: width and height of the images.
    """
    views = _sharp_views(views)
    if not views:
        return []
    outlines = np.array([_normalised_outlines(view, size) for view in views])
    chosen = [int(np.argmax([_sharpness(view) for view in views]))]
    distance = np.linalg.norm(outlines - outlines[chosen[0]], axis=1)
    while len(chosen) < max_count and distance.max() > _MIN_DIFFERENCE:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(outlines - outlines[chosen[-1]], axis=1))
    return [views[i] for i in sorted(chosen)]


def _sharp_views(views: Sequence[View]) -> list[View]:
    if not views:
        return []
    sharpness = np.array([_sharpness(view) for view in views])
    limit = _MIN_SHARPNESS * float(np.median(sharpness))
    return [view for view, value in zip(views, sharpness, strict=True) if value >= limit]


def _sharpness(view: View) -> float:
    return min(each.sharpness for each in view.detections if each is not None)


def _normalised_outlines(view: View, size: tuple[int, int]) -> Floats:
    """Outlines relative to the image size, clipped, as distortion may extrapolate them far away."""
    outlines = [each.outline / max(size) for each in view.detections if each is not None]
    return np.clip(np.concatenate(outlines).ravel(), -1.0, 2.0)
