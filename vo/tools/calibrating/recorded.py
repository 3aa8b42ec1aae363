"""Calibration of cameras from a recording of a board."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from vo.base.errors import CalibrationError
from vo.recordings.sources.sequence import ImageSequence
from vo.tools.calibrating.board import Board
from vo.tools.calibrating.calibrate import CalibrationResult, calibrate
from vo.tools.calibrating.fit import MIN_VIEWS
from vo.tools.calibrating.missing_board import explain_missing_board
from vo.tools.calibrating.views import detect_views, least_motion_frames

_MAX_GROUP = 10
"""Largest number of frames read for each frame searched."""

Show = Callable[[int, int], None]


def calibrate_recorded(
    source: ImageSequence,
    board: Board,
    span: tuple[int, int | None] = (0, None),
    *,
    model: str = "auto",
    look_at: int = 400,
    views: int = 60,
    progress: Callable[[int], AbstractContextManager[Show]] | None = None,
) -> CalibrationResult:
    """Search the frames with the least motion for the board, and calibrate.

    Args:
        source: the recording, opened without a calibration.
        board: in its images.
        span: first frame, and frame to stop before.
        model: lens model, as for `vo calibrate`.
        look_at: largest number of frames to search.
        views: largest number of views to use.
        progress: gives, for the number of frames to search, what is called with those searched
            and the views found.

    Raises:
        CalibrationError: the board is seen too seldom, or no model fits.
    """
    start, end = span
    count = max(min(end or len(source), len(source)) - start, 1)
    group_size = min(-(-count // look_at), _MAX_GROUP)
    stride = -(-count // (look_at * group_size))
    step = stride * group_size
    chosen = least_motion_frames(source.frames(start, end, stride), group_size)
    cameras = 2 if source.rig.is_stereo else 1
    shown: AbstractContextManager[Show] = nullcontext(lambda searched, found: None)
    if progress is not None:
        shown = progress(-(-count // step))
    with shown as show:
        detected = detect_views(board, chosen, cameras, os.cpu_count() or 1, show)
    if len(detected.views) < min(MIN_VIEWS, detected.frames / 2):
        raise CalibrationError(
            explain_missing_board(board, detected, source.frames(start, end, step))
        )
    size = (source.rig.cam0.width, source.rig.cam0.height)
    return calibrate(board, detected, size, model, views)
