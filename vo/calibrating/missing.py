"""Why a board was not found: what there is instead, in one line."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

import cv2
import numpy as np

from vo.calibrating.board import Board, dictionaries, make_board
from vo.calibrating.detection import detect
from vo.calibrating.survey import Survey
from vo.errors import ConfigError
from vo.types import Bytes, Frame

_IMAGES = 8
_SMALLEST = (3, 3)
_ENOUGH_MARKERS = 4


def why_not_found(board: Board, found: Survey, frames: Iterable[Frame]) -> str:
    """What to tell a user whose board was found nowhere, or hardly anywhere.

    Args:
        board: that was looked for.
        found: in how many frames.
        frames: some or all of them, to look for another board.
    """
    every = max(found.frames // _IMAGES, 1)
    images = [frame.image0 for frame in islice(frames, 0, None, every)][:_IMAGES]
    seen = len(found.views)
    message = (
        f"{board}: seen in {seen} of {found.frames} frames"
        if seen
        else (f"no {board} in any of {found.frames} frames")
    )
    if board.kind == "chessboard":
        return f"{message}; {_other_chessboard(images)}"
    return f"{message}; {_other_markers(board, images)}"


def _other_chessboard(images: list[Bytes]) -> str:
    # Of a ChArUco board the squares without markers can pass for a small chessboard.
    if _most_markers(images)[0] >= _ENOUGH_MARKERS:
        return "there are markers: a ChArUco board? (--board charuco)"
    size = _largest_chessboard(images)
    if size is not None:
        options = f"--columns {size[0]} --rows {size[1]}"
        return f"one of {size[0]} x {size[1]} inner corners is there: {options}?"
    return (
        "check --columns and --rows (corners where four squares meet, not squares); a chessboard "
        "must be seen whole, with a white margin (a ChArUco board need not)"
    )


def _largest_chessboard(images: list[Bytes]) -> tuple[int, int] | None:
    """Columns and rows of the largest that any image shows."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    sizes = []
    for image in images:
        ok, _, meta = cv2.findChessboardCornersSBWithMeta(image, _SMALLEST, flags)
        if ok:
            sizes.append((max(meta.shape), min(meta.shape)))  # it can be read either way
    return max(sizes, key=lambda size: size[0] * size[1], default=None)


def _other_markers(board: Board, images: list[Bytes]) -> str:
    if max(_count(board.dictionary, image) for image in images) >= _ENOUGH_MARKERS:
        return _other_layout(board, images)
    if _is_there(board, [np.ascontiguousarray(image[:, ::-1]) for image in images]):
        return "it is there in mirror image: switch mirroring off where the camera is recorded"
    count, best = _most_markers(images)
    if count >= _ENOUGH_MARKERS:
        return f"there are markers of another dictionary: --dictionary {best}?"
    size = _largest_chessboard(images)
    if size is not None:
        options = f"--board chessboard --columns {size[0]} --rows {size[1]}"
        return f"a chessboard without markers is there: {options}?"
    return "no markers are seen either; check --board and --dictionary, and that images are sharp"


def _most_markers(images: list[Bytes]) -> tuple[int, str]:
    """How many markers of which dictionary are seen at once; the smallest of those with as many."""
    few = images[::3]  # there are many dictionaries
    counts = {name: max(_count(name, image) for image in few) for name in dictionaries()}
    best = max(counts, key=lambda name: counts[name])
    return counts[best], best


def _other_layout(board: Board, images: list[Bytes]) -> str:
    """Of boards that are often meant instead, the one that is seen."""
    columns, rows = board.columns, board.rows
    shapes = [(columns, rows), (columns - 1, rows - 1), (columns + 1, rows + 1)]
    for one, other in [*shapes, *(shape[::-1] for shape in shapes)]:
        for legacy in (board.legacy, not board.legacy):
            try:
                meant = make_board(
                    board.kind,
                    one,
                    other,
                    board.square_m,
                    board.marker_m,
                    board.dictionary,
                    legacy,
                )
            except ConfigError:
                continue
            if _is_there(meant, images):
                word = " with" if legacy else " without"
                option = "" if legacy == board.legacy else f"{word} --legacy"
                options = f"--columns {one} --rows {other}{option}"
                return f"one of {one} x {other} inner corners is there: {options}?"
    return (
        f"markers of {board.dictionary} are there, but not as on such a board: check --columns "
        "and --rows (inner corners, one less than squares), or try --legacy"
    )


def _is_there(board: Board, images: list[Bytes]) -> bool:
    """Whether every other image shows most of it: a few corners fit boards of other sizes too."""
    found = [detect(board, image) for image in images]
    enough = [each for each in found if each is not None and 2 * len(each.ids) > len(board.points)]
    return 2 * len(enough) >= len(images)


def _count(dictionary: str, image: Bytes) -> int:
    markers = cv2.aruco.getPredefinedDictionary(dictionaries()[dictionary])
    _, ids, _ = cv2.aruco.ArucoDetector(markers).detectMarkers(image)
    return 0 if ids is None else len(ids)
