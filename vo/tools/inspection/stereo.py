"""Checks of a stereo pair with points matched in both images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.geometry.vertical_disparity_model import VerticalDisparityFit
from vo.base.records.calibration_errors import RightCameraError
from vo.base.types import Bytes, Floats, Ints, Rig
from vo.engine.frontend.pair_check import TURNS, disparity_signs
from vo.engine.frontend.pair_matching import PairPoints
from vo.engine.frontend.same_view import is_same_view
from vo.engine.frontend.stereo_time_offset import TimeOffsetEstimator
from vo.engine.geometry.right_camera_error import is_worth_correcting, right_camera_error
from vo.tools.inspection.image_records import StereoReport

_FEATURES = 1500
_MIN_MATCHES = 15
_OUTLIER_PX = 1.0
_NEAR_PX = 3.0
_PATCH_PX = 15
_MAX_SPREAD_PX = 15.0  # of rows, by an error of the calibration
_MIN_TURNED_MATCHES = 50  # in a pair
_Pairs = Sequence[tuple[Bytes, Bytes]]
_MIN_DISPARITY_PX = 1.0
"""Smaller disparities have an unreliable sign."""


def compare_stereo_images(pairs: _Pairs, rig: Rig | None) -> StereoReport | None:
    """Match pairs of images, rectified if there is a calibration; None with too few matches."""
    working = rectified_cameras(rig)
    is_same = [is_same_view(a, b) for a, b in pairs]
    if working is not None:
        pairs = [(working.rectify(a, 0), working.rectify(b, 1)) for a, b in pairs]
    compared = _compare(pairs, working)
    differs = compared is None or abs(compared.row_spread_px) > _MAX_SPREAD_PX
    if working is not None and differs:
        compared = _compare_turned(pairs, working) or compared
    if compared is None:
        return None
    return replace(compared, is_same_camera=any(is_same) and False not in is_same)


def _compare_turned(pairs: _Pairs, working: RectifiedRig) -> StereoReport | None:
    """Comparison with mirrored or turned right images, None if rows do not agree then either."""
    for how, code in TURNS.items():
        turned = [(a, np.asarray(cv2.flip(b, code), dtype=np.uint8)) for a, b in pairs]
        compared = _compare(turned, working)
        if (
            compared is not None
            and compared.matches >= _MIN_TURNED_MATCHES * compared.pairs
            and compared.row_spread_px < _NEAR_PX
            and abs(compared.row_offset_px) < _MAX_SPREAD_PX
        ):
            return replace(compared, right_is=how)
    return None


def _compare(pairs: _Pairs, working: RectifiedRig | None) -> StereoReport | None:
    found = [
        (pair, points) for pair in pairs if len(points := match_features(*pair)) >= _MIN_MATCHES
    ]
    if not found:
        return None
    points = np.concatenate([points for _, points in found])
    rows = points[:, 3] - points[:, 1]
    disparity = points[:, 0] - points[:, 2]
    clear = disparity[np.abs(disparity) > _MIN_DISPARITY_PX]
    # Corners are at integer pixels; the mean around the median gives subpixel accuracy.
    near = rows[np.abs(rows - np.median(rows)) < _NEAR_PX]
    offset, median = float(near.mean()), float(np.median(disparity))
    depth = None
    if working is not None and working.baseline_m and median > 0:
        depth = working.fx * working.baseline_m / median
    return StereoReport(
        rectified=working is not None,
        pairs=len(found),
        matches=len(points),
        row_offset_px=offset,
        row_spread_px=float(near.std()) if len(near) > 0.5 * len(rows) else float(rows.std()),
        positive=float((clear > 0).mean()) if len(clear) else 1.0,
        disparity_px=median,
        depth_m=depth,
        right_camera=None if working is None else _right_camera(found, working),
        are_exchanged=working is not None and disparity_signs(disparity, working.fx).are_exchanged,
    )


def _right_camera(
    found: Sequence[tuple[tuple[Bytes, Bytes], Floats]], rig: RectifiedRig
) -> RightCameraError | None:
    """Error of the right camera's calibration from the rows of all pairs, if significant."""
    fit = VerticalDisparityFit()
    for pair, points in found:
        exact = refined_points(*pair, points)
        x, y = (exact[:, 2] - rig.cx) / rig.fx, (exact[:, 1] - rig.cy) / rig.fy
        if len(exact) >= _MIN_MATCHES:
            fit.add(x, y, exact[:, 3] - exact[:, 1], exact[:, 0] - exact[:, 2])
    fitted = fit.result()
    return right_camera_error(fitted.errors, rig) if is_worth_correcting(fitted, rig) else None


def refined_points(left: Bytes, right: Bytes, points: Floats) -> Floats:
    """Points (N, 4) with subpixel positions in the right image."""
    a, b = points[:, :2].astype(np.float32), points[:, 2:].astype(np.float32)
    side, flags = (_PATCH_PX, _PATCH_PX), cv2.OPTFLOW_USE_INITIAL_FLOW
    moved, good, _ = cv2.calcOpticalFlowPyrLK(
        left, right, a, b.copy(), None, None, side, 0, flags=flags
    )
    near = np.linalg.norm(moved - b, axis=1) < _NEAR_PX
    kept = (good.ravel() > 0) & near
    return np.asarray(np.hstack([a, moved])[kept], dtype=np.float64)


def match_features(left: Bytes, right: Bytes) -> Floats:
    """Match ORB features consistent with one epipolar geometry; (N, 4) left u, v and right u, v."""
    orb = cv2.ORB.create(_FEATURES)
    left_points, left_bits = orb.detectAndCompute(left, None)
    right_points, right_bits = orb.detectAndCompute(right, None)
    if left_bits is None or right_bits is None:
        return np.empty((0, 4))
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(left_bits, right_bits)
    if len(pairs) < _MIN_MATCHES:
        return np.empty((0, 4))
    a = np.array([left_points[pair.queryIdx].pt for pair in pairs])
    b = np.array([right_points[pair.trainIdx].pt for pair in pairs])
    try:
        _, agree = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, _OUTLIER_PX, 0.999, 2000)
    except cv2.error:  # as between two images of one camera
        agree = np.abs(a - b).max(axis=1, keepdims=True) <= _OUTLIER_PX
    if agree is None:
        return np.empty((0, 4))
    return np.asarray(np.hstack([a, b])[agree.ravel() > 0], dtype=np.float64)


def rectified_cameras(rig: Rig | None) -> RectifiedRig | None:
    """The rectified cameras of a pair, None without a pair that can be rectified."""
    if rig is None or not rig.is_stereo:
        return None
    try:
        return rectified_rig(rig)
    except CalibrationError:
        return None


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

    `read_left`: reads a left image by number, None if it is unreadable. `stamps_ns`: (N,) of all
    left images.
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
