"""Warnings about a run, as text."""

from __future__ import annotations

from collections.abc import Sequence

from vo.calibration_errors import LensError, RightCameraError
from vo.failures import ImageDefect
from vo.results.frames_without_pose import FrameRange

_MIN_DISPARITY_ERROR_PX = 0.05  # smaller ones are not reported
_MAX_EDGE_PX = 15.0  # larger ones are not explained by slightly wrong radial distortion
_USUAL_OFFSET_PX = 0.1  # disparity offset of a well calibrated pair
_FAR_SCENE_PX = 2.0  # median disparity at which the usual offset changes lengths by 5 %
_MAX_RANGES = 3  # listed in a warning


def image_defect_warnings(without_pose: Sequence[FrameRange]) -> list[str]:
    """One warning for each kind of image defect."""
    return [text for defect in ImageDefect for text in _image_defect_warning(without_pose, defect)]


def calibration_warnings(
    right_camera: RightCameraError | None,
    lens: LensError | None,
    offset_px: float,
    curve_px: float,
    implausible_px: float,
) -> list[str]:
    """One warning for each error of the calibration.

    Args:
        right_camera: None without an error.
        lens: None without an error.
        offset_px: constant bias of the disparities.
        curve_px: their bias at one focal length from the principal point.
        implausible_px: a bias that is too large to be corrected, 0 without one.
    """
    warnings = []
    if right_camera is not None:
        warnings.append(_right_camera_warning(right_camera))
    is_explained = right_camera is not None and right_camera.yaw_deg != 0.0
    if abs(offset_px) >= _MIN_DISPARITY_ERROR_PX and not is_explained:
        warnings.append(_offset_warning(offset_px))
    if abs(curve_px) >= _MIN_DISPARITY_ERROR_PX and not is_explained:
        warnings.append(_curve_warning(curve_px))
    if implausible_px != 0.0:
        warnings.append(_implausible_warning(implausible_px))
    if lens is not None:
        warnings.append(_lens_warning(lens))
    return warnings


def far_scene_warnings(median_disparity_px: float | None) -> list[str]:
    """A warning if the median disparity is so small that its usual offset matters."""
    if median_disparity_px is None or median_disparity_px >= _FAR_SCENE_PX:
        return []
    error = _USUAL_OFFSET_PX / median_disparity_px
    return [
        f"the scene is far away for this baseline (median disparity {median_disparity_px:.1f} px): "
        f"a calibration error of {_USUAL_OFFSET_PX} px in disparity changes lengths by {error:.0%}"
    ]


def _image_defect_warning(without_pose: Sequence[FrameRange], defect: ImageDefect) -> list[str]:
    ranges = [r for r in without_pose if r.defect is defect]
    if not ranges:
        return []
    frames = [str(r.first) if r.frames == 1 else f"{r.first} to {r.last}" for r in ranges]
    more = ", …" if len(frames) > _MAX_RANGES else ""
    return [f"images {', '.join(frames[:_MAX_RANGES])}{more} are {defect.value}"]


def _right_camera_warning(error: RightCameraError) -> str:
    return (
        f"the right camera differs from its calibration ({error.in_words}); this has been "
        "corrected, but calibrate again: vo calibrate"
    )


def _lens_warning(error: LensError) -> str:
    amount = f"k1 by {error.k1:+.4f}, {error.edge_px:+.1f} px at the image's edges"
    if abs(error.edge_px) < _MAX_EDGE_PX:
        advice = "this has been corrected, but calibrate again"
    else:
        advice = "one coefficient cannot correct this; the path is inaccurate: calibrate again"
    return f"the lens differs from its calibration ({amount}); {advice}: vo calibrate"


def _curve_warning(curve_px: float) -> str:
    return (
        f"disparities on the left and right were wrong by up to {curve_px:+.2f} px (at one focal "
        "length from the image's centre, growing with the square) and have been corrected: the "
        "stereo calibration is slightly wrong"
    )


def _offset_warning(offset_px: float) -> str:
    return (
        f"all disparities were wrong by {offset_px:+.2f} px and have been corrected: the "
        "stereo calibration is slightly wrong"
    )


def _implausible_warning(bias_px: float) -> str:
    return (
        f"disparities and motion contradict each other by {bias_px:+.1f} px, too much for a "
        "slightly wrong calibration: nothing was corrected, and all lengths are wrong; check focal "
        "length, baseline and image size (vo info shows them), and whether something stands still "
        "in the images"
    )
