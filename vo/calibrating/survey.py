"""Which frames of a recording show the board, and which of them to calibrate with."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice, pairwise

import cv2
import numpy as np

from vo.calibrating.board import Board
from vo.calibrating.detection import Detection, detect
from vo.types import Bytes, Floats, Frame

_WAITING = 6
_SHRINK = 4
_BLURRED = 0.6
"""Of the median sharpness: images below are left out, if there are enough others."""

_ALIKE = 0.02
"""Of the image's longer side: views whose outlines differ less show the same again."""


@dataclass(frozen=True, eq=False)
class View:
    """A frame that shows the board.

    Attributes:
        frame: number of the frame in its recording.
        stamp_ns: its time.
        sides: what camera 0 and camera 1 see; None where the board is not found.
    """

    frame: int
    stamp_ns: int
    sides: tuple[Detection | None, ...]


@dataclass(frozen=True, eq=False)
class Survey:
    """What was found in a recording.

    Attributes:
        frames: how many frames were looked at.
        cameras: 1 or 2.
        views: those that show the board to at least one camera, in order.
    """

    frames: int
    cameras: int
    views: tuple[View, ...]

    def seen_by(self, camera: int) -> list[View]:
        """The views in which a camera sees the board."""
        return [view for view in self.views if view.sides[camera] is not None]


def survey(
    board: Board,
    frames: Iterable[Frame],
    cameras: int,
    threads: int,
    progress: Callable[[int, int], None] = lambda looked_at, found: None,
) -> Survey:
    """Look for the board in all frames.

    Args:
        board: the board.
        frames: of the recording.
        cameras: how many there are, 1 or 2.
        threads: how many images to work on at a time; the result is the same with any number.
        progress: told after each frame how many were looked at and how many show the board.
    """
    views: list[View] = []
    looked_at = 0
    for view in _looked_through(board, frames, cameras, threads):
        looked_at += 1
        if any(side is not None for side in view.sides):
            views.append(view)
        progress(looked_at, len(views))
    return Survey(looked_at, cameras, tuple(views))


def stillest(frames: Iterable[Frame], of: int) -> Iterator[Frame]:
    """Of every so many frames the one in which least moves.

    What stands still is sharp, not bent by a rolling shutter, and the same to two cameras that do
    not take their images at the same moment.
    """
    rest = iter(frames)
    while group := list(islice(rest, of)):
        paired = [frame for frame in group if frame.image1 is not None]
        yield _stillest(paired or group)


def _stillest(group: Sequence[Frame]) -> Frame:
    if len(group) == 1:
        return group[0]
    size = [max(side // _SHRINK, 1) for side in group[0].image0.shape[::-1]]
    small = [cv2.resize(frame.image0, size, interpolation=cv2.INTER_AREA) for frame in group]
    changes = [float(np.mean(cv2.absdiff(a, b))) for a, b in pairwise(small)]
    # The larger of before and after: a copy of the frame before is not still.
    around = [max(changes[max(i - 1, 0) : i + 1]) for i in range(len(group))]
    return group[int(np.argmin(around))]


def _looked_through(
    board: Board, frames: Iterable[Frame], cameras: int, threads: int
) -> Iterator[View]:
    waiting: deque[tuple[Frame, list[Future[Detection | None] | None]]] = deque()
    with ThreadPoolExecutor(max_workers=max(threads, 1)) as pool:
        for frame in frames:
            images: list[Bytes | None] = [frame.image0, frame.image1][:cameras]
            jobs = [
                None if image is None else pool.submit(detect, board, image) for image in images
            ]
            waiting.append((frame, jobs))
            if len(waiting) > _WAITING:
                yield _finished(*waiting.popleft())
        while waiting:
            yield _finished(*waiting.popleft())


def _finished(frame: Frame, jobs: list[Future[Detection | None] | None]) -> View:
    sides = [None if job is None else job.result() for job in jobs]
    if len(sides) == 2 and sides[0] is not None and sides[1] is not None:
        sides[1] = _ordered_like(sides[0], sides[1])
    return View(frame.index, frame.stamp_ns, tuple(sides))


def _ordered_like(left: Detection, right: Detection) -> Detection:
    """The right corners numbered from the end where that is what the left ones are.

    Half a turn leaves a chessboard as it was, so that each image may be numbered from either end.
    """
    if len(left.ids) != len(right.ids) or not np.array_equal(left.ids, right.ids):
        return right
    shape = left.outline - left.outline.mean(axis=0)
    other = right.outline - right.outline.mean(axis=0)
    if np.sum(shape * other) >= 0.0:
        return right
    return Detection(right.ids, right.xy[::-1], right.outline[[2, 3, 0, 1]], right.sharpness)


def choose_views(views: Sequence[View], most: int, size: tuple[int, int]) -> list[View]:
    """The most different of the sharp views, in order.

    A view is described by where the outermost corners of the board are: place, distance, tilt and
    turn are all in there. Beginning with the sharpest, the view is added that is farthest from all
    that were chosen, until none is left that shows anything else.

    Args:
        views: to choose from; every view has the same sides.
        most: how many to choose.
        size: width and height of the images.
    """
    views = _sharp(views)
    if not views:
        return []
    places = np.array([_place(view, size) for view in views])
    chosen = [int(np.argmax([_sharpness(view) for view in views]))]
    distance = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < most and distance.max() > _ALIKE:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return [views[i] for i in sorted(chosen)]


def _sharp(views: Sequence[View]) -> list[View]:
    if not views:
        return []
    sharpness = np.array([_sharpness(view) for view in views])
    limit = _BLURRED * float(np.median(sharpness))
    return [view for view, value in zip(views, sharpness, strict=True) if value >= limit]


def _sharpness(view: View) -> float:
    return min(side.sharpness for side in view.sides if side is not None)


def _place(view: View, size: tuple[int, int]) -> Floats:
    """Outlines in units of the image, kept near it where a lens bends them away."""
    outlines = [side.outline / max(size) for side in view.sides if side is not None]
    return np.clip(np.concatenate(outlines).ravel(), -1.0, 2.0)
