"""Check whether left and right images are taken at the same time, from rows and motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from vo.base.geometry.rectification import RectifiedRig
from vo.base.types import Bytes, Ints
from vo.engine.frontend.pair_matching import PairPoints
from vo.engine.frontend.time_offset import TimeOffsetEstimator
from vo.tools.inspection.image_records import StereoReport
from vo.tools.inspection.stereo import match_features, refined_points

_USUAL_SPREAD_PX = 0.5  # of rows; a pair with less needs no further check


class NumberedPair(NamedTuple):
    """The recorded images of a pair, and the number of the left one."""

    number: int
    left: Bytes
    right: Bytes


def time_offset_ms(
    pairs: Sequence[NumberedPair],
    read_left: Callable[[int], Bytes | None],
    stamps_ns: Ints,
    rig: RectifiedRig,
) -> float | None:
    """Time of right images minus that of left ones of the same stamp; None if none is certain.

    Args:
        pairs: some pairs.
        read_left: reads a left image by number, None if it is unreadable.
        stamps_ns: (N,) of all left images.
        rig: the rectified cameras.
    """
    estimator = TimeOffsetEstimator(rig)
    for number, left, right in pairs:
        if not 0 < number < len(stamps_ns) - 1:
            continue
        before, after = read_left(number - 1), read_left(number + 1)
        if before is None or after is None:
            continue
        rectified = rig.rectify(left, 0), rig.rectify(right, 1)
        points = refined_points(*rectified, match_features(*rectified))
        estimator.next_image(int(stamps_ns[number - 1]), rig.rectify(before, 0))
        estimator.next_image(int(stamps_ns[number]), rectified[0])
        estimator.add(int(stamps_ns[number]), PairPoints(points[:, :2], points[:, 2:]))
        estimator.next_image(int(stamps_ns[number + 1]), rig.rectify(after, 0))
    return estimator.offset_ms


def is_suspect(stereo: StereoReport) -> bool:
    """Whether rows differ by so much that the time of the images may be the cause."""
    is_spread = stereo.row_spread_px > _USUAL_SPREAD_PX or stereo.right_camera is not None
    return stereo.rectified and is_spread and not stereo.right_is
