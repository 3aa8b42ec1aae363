"""What is wrong with a calibration, by itself and against the images."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vo.errors import CalibrationError
from vo.geometry.rectification import rectified_rig
from vo.inspection.records import CameraReport, Finding, LensReport, Report
from vo.types import Rig

_USUAL_VIEW_DEG = (15.0, 150.0)
_USUAL_BASELINE_M = (0.005, 5.0)
_USUAL_DEPTH_M = (0.1, 300.0)
_ROWS_APART_PX = 1.0
_ROWS_SPREAD_PX = 1.5
_CORRECTED_PX = 15.0  # vo run looks for rows so far apart, and somewhat more in tall images
_SWAPPED = 0.3
"""Share of positive disparities below which left is right."""


def in_calibration(report: Report, rig: Rig | None) -> Iterator[Finding]:
    """What is wrong with each camera, and with the two together."""
    known = report.calibration
    if known is None or rig is None:
        return
    for lens, camera in zip(known.lenses, report.cameras, strict=False):
        yield from _lens(lens, camera)
    if known.baseline_m is None:
        yield from _without_pair(report)
        return
    yield from in_pair(report, rig)


def _baseline(length_m: float) -> Iterator[Finding]:
    low, high = _USUAL_BASELINE_M
    if length_m > high:
        unit = 1000 if length_m / 1000 > low else 100
        yield Finding(
            "error",
            f"the baseline is {length_m:g} m",
            f"lengths are in metres: if it is {length_m / unit:g} m, divide by {unit}",
        )
    elif length_m < low:
        yield Finding(
            "warning", f"the baseline is {length_m:g} m", "check its unit: lengths are in metres"
        )


def in_pair(report: Report, rig: Rig) -> Iterator[Finding]:
    """What is wrong between left and right."""
    if rig.cam1_from_cam0 is None:
        return
    yield from _baseline(float(np.linalg.norm(rig.cam1_from_cam0[:3, 3])))
    try:
        rectified_rig(rig)
    except CalibrationError as error:
        yield Finding("error", str(error))
    stereo = report.stereo
    if stereo is not None and stereo.positive < _SWAPPED:
        yield Finding(
            "error",
            "left and right are swapped: points lie further right in the right image "
            f"({100 * (1 - stereo.positive):.0f} % of them)",
            "swap the cameras and their calibration, or use --mode mono",
        )
    elif stereo is not None and stereo.rectified:
        right = stereo.right_camera
        if right is not None and right.rows_px < _CORRECTED_PX:
            yield Finding(
                "warning",
                f"the right camera is not as calibrated ({right.in_words})",
                "vo run corrects that as well as it can; calibrate again: vo calibrate",
            )
        elif abs(stereo.row_offset_px) > _ROWS_APART_PX or stereo.row_spread_px > _ROWS_SPREAD_PX:
            yield Finding(
                "error",
                "after rectification, rows of left and right differ by "
                f"{stereo.row_offset_px:+.2f} px and scatter by {stereo.row_spread_px:.2f} px",
                "the calibration does not fit these images: calibrate again",
            )
        if stereo.depth_m is not None and not (
            _USUAL_DEPTH_M[0] <= stereo.depth_m <= _USUAL_DEPTH_M[1]
        ):
            yield Finding(
                "warning",
                f"with this baseline, points are {stereo.depth_m:.3g} m away (median)",
                "check the unit of the baseline: metres",
            )


def _without_pair(report: Report) -> Iterator[Finding]:
    stereo = report.stereo
    if stereo is not None and len(report.cameras) == 2:
        rows = abs(stereo.row_offset_px) < 0.5 and stereo.row_spread_px < 0.7
        yield Finding(
            "note",
            "the right camera is not calibrated; its images "
            + ("look rectified" if rows else "are not rectified")
            + f" (rows differ by {stereo.row_offset_px:+.2f} px)",
            "with its calibration lengths would be metric",
        )


def _lens(lens: LensReport, camera: CameraReport) -> Iterator[Finding]:
    if camera.width and (lens.width, lens.height) != (camera.width, camera.height):
        yield Finding(
            "error",
            f"{lens.name}: the calibration is for {lens.width}x{lens.height}, the images are "
            f"{camera.width}x{camera.height}",
            "give the calibration of these images; vo convert --resize scales both together",
        )
    view = lens.view_deg[0]
    if view is not None and not _USUAL_VIEW_DEG[0] <= view <= _USUAL_VIEW_DEG[1]:
        yield Finding(
            "warning",
            f"{lens.name}: a focal length of {lens.fx:g} px for {lens.width} px of width is a view "
            f"of {view:.0f} degrees",
            "compare with the lens; the focal length is in pixels of these very images",
        )
    if abs(lens.fx / lens.fy - 1.0) > 0.05:
        yield Finding(
            "warning",
            f"{lens.name}: fx {lens.fx:g} and fy {lens.fy:g} differ by more than 5 %",
            "most pixels are square; was the image stretched?",
        )
    off = max(abs(lens.cx / lens.width - 0.5), abs(lens.cy / lens.height - 0.5))
    if off > 0.12:
        yield Finding(
            "warning",
            f"{lens.name}: the principal point ({lens.cx:.1f}, {lens.cy:.1f}) is {100 * off:.0f} % "
            "off the middle of the image",
            "true of cropped images; else the calibration is of another size",
        )
