"""Explanation of why no board was found: the board that is there instead."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

import cv2
import numpy as np

from vo.base.errors import ConfigError
from vo.base.types import Bytes, Frame
from vo.tools.calibrating.board import Board, dictionaries, make_board
from vo.tools.calibrating.detection import detect
from vo.tools.calibrating.views import DetectedViews

_IMAGES = 8
_MIN_SIZE = (3, 3)
_MIN_MARKERS = 4


def explain_missing_board(board: Board, detected: DetectedViews, frames: Iterable[Frame]) -> str:
    """One line for a user whose board was found in no frame, or hardly any.

    `frames`: some or all of the frames, to search for another board.
    """
    step = max(detected.frames // _IMAGES, 1)
    images = [frame.image0 for frame in islice(frames, 0, None, step)][:_IMAGES]
    seen = len(detected.views)
    message = (
        f"{board}: seen in only {seen} of {detected.frames} frames"
        if seen
        else f"no {board} in any of {detected.frames} frames"
    )
    if board.kind == "chessboard":
        return f"{message}; {_other_chessboard(images)}"
    return f"{message}; {_other_markers(board, images)}"


def _other_chessboard(images: list[Bytes]) -> str:
    # The squares without markers of a ChArUco board may be taken for a small chessboard.
    if _best_dictionary(images)[0] >= _MIN_MARKERS:
        return "markers were found: is it a ChArUco board (`board=charuco`)?"
    size = _largest_chessboard(images)
    if size is not None:
        options = f"`columns={size[0]}` `rows={size[1]}`"
        return f"a board of {size[0]} x {size[1]} inner corners was found: {options}?"
    return (
        "check `columns` and `rows` (corners where four squares meet, not squares); a chessboard "
        "must be completely visible, with a white margin (unlike a ChArUco board)"
    )


def _largest_chessboard(images: list[Bytes]) -> tuple[int, int] | None:
    """Columns and rows of the largest chessboard in any of the images."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    sizes = []
    for image in images:
        ok, _, meta = cv2.findChessboardCornersSBWithMeta(image, _MIN_SIZE, flags)
        if ok:
            sizes.append((max(meta.shape), min(meta.shape)))  # rows and columns may be swapped
    return max(sizes, key=lambda size: size[0] * size[1], default=None)


def _other_markers(board: Board, images: list[Bytes]) -> str:
    if max(_count(board.dictionary, image) for image in images) >= _MIN_MARKERS:
        return _other_layout(board, images)
    if _is_visible(board, [np.ascontiguousarray(image[:, ::-1]) for image in images]):
        return "the board is there, but the images are mirrored: turn off mirroring in the camera"
    count, best = _best_dictionary(images)
    if count >= _MIN_MARKERS:
        return f"markers of another dictionary were found: `dictionary={best}`?"
    size = _largest_chessboard(images)
    if size is not None:
        options = f"`board=chessboard` `columns={size[0]}` `rows={size[1]}`"
        return f"a chessboard without markers was found: {options}?"
    return "no markers were found; check `board`, `dictionary` and the sharpness of the images"


def _best_dictionary(images: list[Bytes]) -> tuple[int, str]:
    """Largest number of markers in an image, and their dictionary; the smallest of equals."""
    few = images[::3]  # few, because there are many dictionaries
    counts = {name: max(_count(name, image) for image in few) for name in dictionaries()}
    best = max(counts, key=lambda name: counts[name])
    return counts[best], best


def _other_layout(board: Board, images: list[Bytes]) -> str:
    """Search for layouts that are often confused with the given one."""
    columns, rows = board.columns, board.rows
    shapes = [(columns, rows), (columns - 1, rows - 1), (columns + 1, rows + 1)]
    for one, other in [*shapes, *(shape[::-1] for shape in shapes)]:
        for legacy in (board.legacy, not board.legacy):
            try:
                other_board = make_board(
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
            if _is_visible(other_board, images):
                word = " with" if legacy else " without"
                option = "" if legacy == board.legacy else f"{word} `legacy`"
                options = f"`columns={one}` `rows={other}`{option}"
                return f"a board of {one} x {other} inner corners was found: {options}?"
    return (
        f"markers of {board.dictionary} were found, but in another layout: check `columns` "
        "and `rows` (inner corners, one less than squares), or try `legacy`"
    )


def _is_visible(board: Board, images: list[Bytes]) -> bool:
    """Whether half of the images show most of the board; fewer corners fit other sizes too."""
    detections = [detect(board, image) for image in images]
    enough = [
        each for each in detections if each is not None and 2 * len(each.ids) > len(board.points)
    ]
    return 2 * len(enough) >= len(images)


def _count(dictionary: str, image: Bytes) -> int:
    markers = cv2.aruco.getPredefinedDictionary(dictionaries()[dictionary])
    _, ids, _ = cv2.aruco.ArucoDetector(markers).detectMarkers(image)
    return 0 if ids is None else len(ids)
