"""Warnings about a run, as text."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from vo.base.failures import ImageDefect, describe
from vo.base.faults import FaultKind
from vo.base.printable import counted
from vo.base.records.calibration_errors import CameraPoseError, LensError, RightCameraError
from vo.base.records.closed_loops import MapUse
from vo.base.records.inertial_use import InertialUse
from vo.outputs.results.fault_warnings import fault_warnings
from vo.outputs.results.live_summary import live_warnings
from vo.outputs.results.run_statistics import FrameRange
from vo.outputs.results.verdict import MIN_INLIERS

if TYPE_CHECKING:
    from vo.outputs.results.summary import Summary

_MIN_DISPARITY_ERROR_PX = 0.05  # smaller ones are not reported
_USUAL_OFFSET_PX = 0.1  # disparity offset of a well calibrated pair
_FAR_SCENE_PX = 2.0  # median disparity at which the usual offset changes lengths by 5 %
_LONG_START = 0.1  # fraction of the frames before the first map that is reported
_MAX_TIME_OFFSET_S = 0.004  # error of that of an inertial sensor that is not reported
_MAX_RANGES = 3  # listed in a warning


def run_warnings(summary: Summary) -> list[str]:
    """All warnings about a run."""
    faults = [  # a sensor that is left out is reported with the cause
        each
        for each in summary.faults
        if each.kind is not FaultKind.INERTIAL_CONTRADICTION or not each.is_handled
    ]
    return [
        *(each.text for each in summary.facts.opening_warnings if each.kind != "fault"),
        *fault_warnings(faults),
        *_tracking_warnings(summary),
        *live_warnings(summary.live, summary.frames),
        *calibration_warnings(
            summary.right_camera,
            summary.lens_error,
            summary.disparity_offset_px,
            summary.disparity_curve_px,
            [record.kind for record in summary.faults if not record.is_handled],
            is_pair=summary.facts.mode == "stereo",
        ),
        *map(_camera_warning, summary.camera_errors),
        *far_scene_warnings(summary.median_disparity_px),
        *map_warnings(summary.map, [s.segment for s in summary.segments]),
        *_world_warnings(summary),
        *inertial_warnings(summary.inertial, summary.inertial_poses, summary.inertial_orientations),
    ]


def _tracking_warnings(summary: Summary) -> list[str]:
    frames, lost, inliers = summary.frames, summary.lost, summary.median_inliers or 0.0
    warnings = []
    if summary.tracked == 0:
        reason = describe(summary.main_failure) or "no frame read"
        warnings.append(f"no frame was tracked ({reason})")
    elif summary.starting > _LONG_START * frames:
        warnings.append(f"{summary.starting} of {frames} frames before the first map")
    warnings += image_defect_warnings(summary.without_pose)
    if lost:
        warnings.append(f"lost in {lost} of {frames} frames ({lost / frames:.0%})")
    if summary.skipped:
        warnings.append(
            f"{counted(len(summary.skipped), 'frame')} skipped: the images cannot be used"
        )
    if summary.unpaired:
        is_rig = summary.facts.mode == "rig"
        missing = "the image of a camera" if is_rig else "right or depth image"
        warnings.append(f"{counted(summary.unpaired, 'frame')} used without {missing}")
    if summary.tracked and inliers < MIN_INLIERS:
        warnings.append(f"poor tracking: median of {inliers:.0f} inliers")
    return warnings


def _world_warnings(summary: Summary) -> list[str]:
    warnings = []
    if len(summary.segments) > 1:
        warnings.append(f"{len(summary.segments)} segments, each in its own world frame")
    if any(loop.repairs for loop in summary.loops):
        warnings.append(
            "tracking was wrong in frames in which little of the map agreed, as loops show: the "
            "path follows the loops, and is inaccurate there; compare with a run with "
            "`memory.loops=false`"
        )
    if any(loop.marker is not None and loop.joins and not loop.repairs for loop in summary.loops):
        warnings.append(
            "parts of the path are joined by markers that were seen in both: no other marker may "
            "have their ids, and they must not have been moved"
        )
    if any(loop.marker is None and loop.joins and not loop.repairs for loop in summary.loops):
        warnings.append(
            "parts of the path are joined only by what places look like; those that look alike, "
            "such as corridors, can be joined wrongly: compare with a run with `memory.loops=false`"
        )
    if summary.scale is not None:
        warnings += summary.scale.notes
    if summary.tracked and not summary.is_metric:
        warnings.append(_unknown_scale(summary))
    return warnings


def _unknown_scale(summary: Summary) -> str:
    known = {} if summary.scale is None else summary.scale.by_segment()
    if not known and summary.has_free_scale and summary.facts.mode != "mono":
        return (
            "no cameras see the same, and the rig has turned too little to tell the scale: lengths "
            "are in map units (vo eval --align sim3); turn by 90° or more"
        )
    if not known:
        return "mono: the scale is unknown, lengths are in map units (vo eval --align sim3)"
    unknown = [str(each.segment) for each in summary.segments if each.segment not in known]
    return (
        "mono: lengths are in metres, except in these segments, which have no scale and are in map "
        f"units: {', '.join(unknown)}"
    )


def image_defect_warnings(without_pose: Sequence[FrameRange]) -> list[str]:
    """One warning for each kind of image defect."""
    return [text for defect in ImageDefect for text in _image_defect_warning(without_pose, defect)]


def calibration_warnings(
    right_camera: RightCameraError | None,
    lens: LensError | None,
    offset_px: float,
    curve_px: float,
    open_faults: Collection[FaultKind],
    *,
    is_pair: bool = False,
) -> list[str]:
    """One warning for each error of the calibration that has been corrected.

    `right_camera`: None without an error. `lens`: None without an error. `offset_px`: constant bias
    of the disparities. `curve_px`: their bias at one focal length from the principal point.
    `open_faults`: kinds of faults that were not handled; a correction that was made beside one is
    no correction.
    """
    warnings = []
    if FaultKind.RIGHT_TIME_OFFSET in open_faults:  # which looks like a wrong calibration
        right_camera, offset_px, curve_px = None, 0.0, 0.0
    if right_camera is not None:
        warnings.append(_right_camera_warning(right_camera))
    is_yaw = right_camera is not None and right_camera.yaw_deg != 0.0
    is_explained = is_yaw or FaultKind.WRONG_STEREO_CALIBRATION in open_faults
    if abs(offset_px) >= _MIN_DISPARITY_ERROR_PX and not is_explained:
        warnings.append(_offset_warning(offset_px))
    if abs(curve_px) >= _MIN_DISPARITY_ERROR_PX and not is_explained:
        warnings.append(_curve_warning(curve_px))
    if lens is not None and FaultKind.WRONG_LENS not in open_faults:
        warnings.append(_lens_warning(lens, is_pair=is_pair))
    return warnings


def map_warnings(use: MapUse | None, segments: Sequence[int]) -> list[str]:
    """A warning if parts of the path are not in the world of the loaded map.

    `use`: the loaded map, None without one. `segments`: numbers of the worlds of the run.
    """
    if use is None or not segments:
        return []
    apart = [segment for segment in segments if segment not in use.met]
    if not apart:
        return []
    if len(apart) == len(segments):
        return [
            f"no segment was merged with the map {use.file}: the path is in a world of its own. "
            "That takes three keyframes at known places, which are recognised from about where, "
            "and in about the direction, that the map's sessions saw them: a drive in the other "
            "direction needs a session of its own in the map, or markers"
        ]
    numbers = ", ".join(str(segment) for segment in apart)
    return [
        f"not in the world of the map {use.file}, in worlds of their own: segments {numbers} (one "
        "joins by three keyframes at known places)"
    ]


def inertial_warnings(use: InertialUse | None, poses: int = 0, orientations: int = 0) -> list[str]:
    """A warning if an inertial sensor is wrong, or its time offset, or if it gave poses alone.

    `use`: the sensor, None without one. `orientations`: frames with an orientation by it, and
    without a position.
    """
    if use is None:
        return []
    if use.reason is not None and use.is_error and use.states is None:
        return [f"{use.sensor} is not used, only the images are: {use.reason} (see vo info)"]
    warnings = [] if use.reason is None or not use.is_error else [f"{use.sensor}: {use.reason}"]
    if poses:
        warnings.append(f"{counted(poses, 'lost frame')} with a pose by the inertial sensor alone")
    if orientations:
        frames = counted(orientations, "frame")
        warnings.append(f"{frames} with an orientation by the gyroscope, and without a position")
    return [*warnings, *_time_offset_warnings(use)]


def _time_offset_warnings(use: InertialUse) -> list[str]:
    if use.stamp_sigma_s:
        return [
            f"stamps of images vary by {1e3 * use.stamp_sigma_s:.2g} ms (one standard deviation): "
            "the inertial sensor agrees with them at regular times only, which were used"
        ]
    if abs(use.used_time_offset_s - use.given_time_offset_s) <= _MAX_TIME_OFFSET_S:
        return []
    used, given = 1e3 * use.used_time_offset_s, 1e3 * use.given_time_offset_s
    return [
        f"{use.sensor}: {used:+.1f} ms were added to stamps of images to get its clock, not "
        f"{given:+.1f} ms as given: put imu: {{time_offset_s: {1e-3 * used:.4f}}} into the "
        "calibration"
    ]


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
    if frames == [str(ranges[0].first)]:
        return [f"image {frames[0]} is {defect.value}"]
    return [f"images {', '.join(frames[:_MAX_RANGES])}{more} are {defect.value}"]


def _right_camera_warning(error: RightCameraError) -> str:
    return (
        f"the right camera differs from its calibration ({error.in_words}); this has been "
        "corrected, but calibrate again: vo calibrate"
    )


def _camera_warning(error: CameraPoseError) -> str:
    return (
        f"camera {error.camera} stands otherwise than its calibration says ({error.in_words}); "
        "this has been corrected, but calibrate again"
    )


def _lens_warning(error: LensError, *, is_pair: bool) -> str:
    amount = f"k1 by {error.k1:+.4f}, {error.edge_px:+.1f} px at the image's edges"
    what = "both lenses differ from their" if is_pair else "the lens differs from its"
    return (
        f"{what} calibration ({amount}); this has been corrected, but calibrate again: vo calibrate"
    )


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
