"""Findings about a calibration, by itself and compared with the images."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.rig_overlap import is_rig
from vo.base.types import Rig
from vo.tools.inspection.image_records import CameraReport, StereoReport
from vo.tools.inspection.reports import Finding, LensReport, Report

_USUAL_VIEW_DEG = (15.0, 150.0)
_USUAL_BASELINE_M = (0.005, 5.0)
_USUAL_DEPTH_M = (0.1, 300.0)
_MAX_OFFSET_PX = 1.0
_MAX_SPREAD_PX = 1.5
_MAX_CORRECTED_PX = 15.0  # search range of `vo run`, which is larger in tall images
_MIN_POSITIVE = 0.3
"""Fraction of positive disparities below which something is wrong with the pair."""


def calibration_findings(
    report: Report, rig: Rig | None, *, is_refused: bool = False
) -> Iterator[Finding]:
    """Findings about each lens, and about the stereo pair.

    `is_refused`: whether the reason why `vo run` refuses the recording is reported already, such as
    a calibration for another image size.
    """
    calibration = report.calibration
    if calibration is None or rig is None:
        return
    for lens, camera in zip(calibration.lenses, report.cameras, strict=False):
        yield from _lens(lens, camera, is_refused)
    if calibration.baseline_m is None:
        yield from _without_pair(report)
        return
    yield from stereo_findings(report, rig)


def _baseline(length_m: float, depth_m: float | None) -> Iterator[Finding]:
    low, high = _USUAL_BASELINE_M
    if length_m > high:
        units = [(100, "centimetres"), (1000, "millimetres")]
        fitting = [
            f"if it is {length_m / factor:g} m, given in {name}, divide by {factor}"
            + (f" (the median depth is {depth_m / factor:.2g} m then)" if depth_m else "")
            for factor, name in units
            if low <= length_m / factor <= high
        ]
        yield Finding(
            "error",
            f"the baseline is {length_m:g} m, which is implausible"
            + (f": points are {depth_m:.3g} m away by it" if depth_m else ""),
            "; ".join(["lengths must be in metres", *fitting]),
        )
    elif length_m < low:
        yield Finding(
            "warning",
            f"the baseline is only {length_m:g} m",
            "check its unit: lengths must be in metres",
        )


def stereo_findings(report: Report, rig: Rig) -> Iterator[Finding]:
    """Findings about the stereo pair, of a larger rig its first two if they are one."""
    if rig.cam1_from_cam0 is None:
        return
    length_m = float(np.linalg.norm(rig.cam1_from_cam0[:3, 3]))
    if is_rig(rig) and report.pair is None:
        if not rig.further and length_m > _USUAL_BASELINE_M[1]:  # far apart by a wrong unit
            yield from _baseline(length_m, None)
        return
    depth_m = None if report.stereo is None else report.stereo.depth_m
    yield from _baseline(length_m, depth_m)
    try:
        rectified_rig(rig)
    except CalibrationError as error:
        yield Finding("error", str(error))
    stereo = report.stereo
    if stereo is not None and (unusable := _unusable_images(stereo)):
        yield unusable
        return
    if stereo is not None and stereo.positive < _MIN_POSITIVE:
        yield Finding(
            "warning",
            f"{1 - stereo.positive:.0%} of the points are farther right in the right image, by a "
            "few pixels",
            "the right camera was turned since its calibration, or left and right are exchanged",
        )
    if stereo is not None and stereo.time_offset_ms is not None:
        offset_ms = stereo.time_offset_ms
        yield Finding(
            "error",
            f"right images show the scene {offset_ms:+.0f} ms from the left ones of the same "
            "stamp, as rows that differ with the motion show",
            f"shift right stamps by {offset_ms:.0f} ms (`right_offset_ns`), and trigger the "
            "cameras together",
        )
    elif stereo is not None and stereo.rectified:
        right = stereo.right_camera
        if right is not None and right.rows_px < _MAX_CORRECTED_PX:
            yield Finding(
                "warning",
                f"the right camera differs from its calibration ({right.in_words})",
                "vo run corrects this as far as possible; better calibrate again: vo calibrate",
            )
        elif abs(stereo.row_offset_px) > _MAX_OFFSET_PX or stereo.row_spread_px > _MAX_SPREAD_PX:
            yield Finding(
                "error",
                "after rectification, rows of left and right points differ by "
                f"{stereo.row_offset_px:+.2f} ± {stereo.row_spread_px:.2f} px",
                "the calibration does not match these images: calibrate again",
            )
        if stereo.depth_m is not None and not (
            _USUAL_DEPTH_M[0] <= stereo.depth_m <= _USUAL_DEPTH_M[1]
        ):
            yield Finding(
                "warning",
                f"with this baseline, the median depth of points is {stereo.depth_m:.3g} m",
                "check the unit of the baseline, which must be in metres",
            )


def _unusable_images(stereo: StereoReport) -> Finding | None:
    """Why images cannot be those of the calibrated pair."""
    if stereo.is_same_camera:
        return Finding(
            "error",
            "left and right show the same image: the same camera twice?",
            "give the topics or folders of both cameras, or use `mode=mono`",
        )
    if stereo.right_is:
        return Finding(
            "error",
            f"the right image is {stereo.right_is}, or the left one is",
            "revert it in the camera's driver, or use `mode=mono`",
        )
    if stereo.are_exchanged:
        return Finding(
            "error",
            "left and right images are exchanged, or both are mirrored or turned by 180°: "
            f"{1 - stereo.positive:.0%} of the points are farther right in the right image",
            "exchange them (`topics=left=… right=…`, or the folders), turn them, or use "
            "`mode=mono`",
        )
    return None


def _without_pair(report: Report) -> Iterator[Finding]:
    stereo = report.stereo
    if stereo is not None and len(report.cameras) == 2:
        rows = abs(stereo.row_offset_px) < 0.5 and stereo.row_spread_px < 0.7
        yield Finding(
            "note",
            "the right camera is not calibrated; its images "
            + ("look rectified" if rows else "are not rectified")
            + f" (rows differ by {stereo.row_offset_px:+.2f} px)",
            "calibrate both cameras for a metric trajectory",
        )


def _lens(lens: LensReport, camera: CameraReport, is_refused: bool) -> Iterator[Finding]:
    if (
        not is_refused
        and camera.width
        and (lens.width, lens.height) != (camera.width, camera.height)
    ):
        yield Finding(
            "error",
            f"{lens.name}: the calibration is for {lens.width}x{lens.height}, but the images are "
            f"{camera.width}x{camera.height}",
            "it seems to be that of images turned by 90 degrees; use that of the images as stored"
            if (lens.height, lens.width) == (camera.width, camera.height)
            else "use the calibration of these images; vo convert --resize scales both",
        )
    view = None if lens.model == "equirectangular" else lens.view_deg[0]
    if view is not None and not _USUAL_VIEW_DEG[0] <= view <= _USUAL_VIEW_DEG[1]:
        yield Finding(
            "warning",
            f"{lens.name}: a focal length of {lens.fx:g} px at a width of {lens.width} px is a "
            f"field of view of {view:.0f} degrees",
            "compare with the lens; the focal length must be in pixels of these images",
        )
    if abs(lens.fx / lens.fy - 1.0) > 0.05:
        yield Finding(
            "warning",
            f"{lens.name}: fx {lens.fx:g} and fy {lens.fy:g} differ by more than 5 %",
            "pixels are usually square; was the image stretched?",
        )
    off = max(abs(lens.cx / lens.width - 0.5), abs(lens.cy / lens.height - 0.5))
    if off > 0.12:
        yield Finding(
            "warning",
            f"{lens.name}: the principal point ({lens.cx:.1f}, {lens.cy:.1f}) is {100 * off:.0f} % "
            "of the image size off the centre",
            "plausible only for cropped images; else the calibration is for another size",
        )
