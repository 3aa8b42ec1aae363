"""What is wrong with a recording, and what to do about it."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace

from vo.errors import CalibrationError
from vo.geometry.rectification import working_rig
from vo.inspection.material import Material
from vo.inspection.pictures import stretches
from vo.inspection.records import CameraReport, Finding, LensReport, Level, Look, Report

_DARK_GREY = 25.0
_BRIGHT_SHARE = 0.3
_BLURRED = 0.62
_FEW_CORNERS = 150
_USUAL_VIEW_DEG = (15.0, 150.0)
_USUAL_BASELINE_M = (0.005, 5.0)
_USUAL_DEPTH_M = (0.1, 300.0)
_ROWS_APART_PX = 1.0
_ROWS_SPREAD_PX = 1.5
_OFFSET_MS = 3.0
_SAID_BETTER = ("have no left partner", "images repeat a stamp")
"""In warnings of sources that come as findings of our own."""

_SEVERITY: dict[Level, int] = {"error": 0, "warning": 1, "note": 2}


def find_all(report: Report, material: Material) -> Report:
    """The report with its findings, the most serious first, and the command to try."""
    findings = [*_refusal(material)]
    for camera in report.cameras:
        findings += [*_time(camera), *_images(camera)]
    findings += [*_pair(report), *_calibration(report, material), *_truth(report)]
    said = " ".join(finding.what for finding in findings)
    findings += [
        Finding("warning", line)
        for line in material.warnings
        if line not in said and not any(known in line for known in _SAID_BETTER)
    ]
    ordered = sorted(findings, key=lambda finding: _SEVERITY[finding.level])
    return replace(report, findings=tuple(ordered), command=_command(report, material))


def is_swapped(report: Report) -> bool:
    """Whether what is called left was seen by the right camera."""
    return report.stereo is not None and report.stereo.positive < 0.3


def _refusal(material: Material) -> Iterator[Finding]:
    if material.refusal:
        yield Finding("error", material.refusal.splitlines()[0])


def _time(camera: CameraReport) -> Iterator[Finding]:
    timing = camera.timing
    if timing.gaps:
        missing = sum(gap.missing for gap in timing.gaps)
        longest = max(timing.gaps, key=lambda gap: gap.seconds)
        yield Finding(
            "warning",
            f"{camera.name}: {_counted(len(timing.gaps), 'gap')}, about "
            f"{_counted(missing, 'image')} missing; the longest is "
            f"{longest.seconds:.3g} s after frame {longest.after_frame} ({longest.at_s:.2f} s)",
            "tracking may be lost there; --start and --end leave such a stretch out",
        )
    if timing.repeated_stamps:
        yield Finding(
            "warning",
            f"{camera.name}: {timing.repeated_stamps} images repeat a stamp and are not used",
            "check whether a node publishes twice, or the bag was merged",
        )
    interval_ms = 1000.0 / timing.rate_hz if timing.rate_hz else 0.0
    if timing.count > 2 and timing.jitter_ms > 0.2 * interval_ms:
        yield Finding(
            "note",
            f"{camera.name}: intervals vary by {timing.jitter_ms:.1f} ms around "
            f"{interval_ms:.1f} ms",
            "take stamps from the camera's driver, not from when the image arrived",
        )


def _images(camera: CameraReport) -> Iterator[Finding]:
    if not camera.looks:
        yield Finding("error", f"{camera.name}: no image can be read")
        return
    if camera.unreadable:
        yield Finding(
            "warning",
            f"{camera.name}: images that cannot be read: frames {_listed(camera.unreadable)}",
            "they are left out",
        )
    if camera.other_sizes:
        yield Finding(
            "error",
            f"{camera.name}: images of another size than {camera.width}x{camera.height}: frames "
            f"{_listed(camera.other_sizes)}",
            "remove them, or give the recordings one by one",
        )
    dark = [look for look in camera.looks if look.mean_grey < _DARK_GREY]
    bright = [look for look in camera.looks if look.bright > _BRIGHT_SHARE]
    blurred = [look for look in camera.looks if look.blur > _BLURRED and look not in dark]
    bare = [look for look in camera.looks if look.corners < _FEW_CORNERS]
    repeats = [look for look in camera.looks if look.repeats]
    yield from _stretch(camera, dark, "dark", "open the aperture, or expose longer")
    yield from _stretch(camera, bright, "over-exposed", "let the exposure be automatic")
    yield from _stretch(camera, blurred, "blurred", "expose shorter, check the focus, go slower")
    yield from _stretch(
        camera, bare, "with hardly a corner", "tracking is hard there; look at the contact sheet"
    )
    yield from _stretch(
        camera, repeats, "the same as the one before", "the driver repeats images: drop them"
    )


def _stretch(
    camera: CameraReport, looks: Sequence[Look], what: str, advice: str
) -> Iterator[Finding]:
    if looks:
        frames = [look.frame for look in looks]
        parts = stretches(frames, [look.frame for look in camera.looks])
        where = ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in parts[:6])
        more = ", …" if len(parts) > 6 else ""
        yield Finding(
            "warning",
            f"{camera.name}: {len(looks)} of {len(camera.looks)} images looked at are {what}: "
            f"frames {where}{more}",
            advice,
        )


def _pair(report: Report) -> Iterator[Finding]:
    pair = report.pair
    if pair is None:
        return
    if not pair.pairs:
        yield Finding(
            "error",
            f"no left image has a right one within {pair.tolerance_ms:.1f} ms; the nearest is "
            f"{pair.offset_ms:+.1f} ms away",
            "synchronise the cameras' clocks, or use --mode mono",
        )
        return
    if pair.left_alone or pair.right_alone:
        yield Finding(
            "warning",
            f"{pair.left_alone} left and {pair.right_alone} right images have no partner",
            "they were dropped by the recorder, or the cameras are not triggered together",
        )
    if abs(pair.offset_ms) > _OFFSET_MS:
        yield Finding(
            "warning",
            f"right images come {pair.offset_ms:+.2f} ms after the left ones",
            "in motion that is a wrong baseline: trigger the cameras together",
        )


def _calibration(report: Report, material: Material) -> Iterator[Finding]:
    known = report.calibration
    if known is None:
        return
    for lens, camera in zip(known.lenses, report.cameras, strict=False):
        yield from _lens(lens, camera)
    if known.baseline_m is None:
        yield from _without_pair(report)
        return
    low, high = _USUAL_BASELINE_M
    if not low <= known.baseline_m <= high:
        unit = 1000 if known.baseline_m / 1000 > low else 100
        yield Finding(
            "error" if known.baseline_m > high else "warning",
            f"the baseline is {known.baseline_m:g} m",
            f"lengths are in metres; if it is {known.baseline_m / unit:g} m, divide by {unit}"
            if known.baseline_m > high
            else "check its unit: lengths are in metres",
        )
    yield from _rig(report, material)


def _rig(report: Report, material: Material) -> Iterator[Finding]:
    assert material.rig is not None
    try:
        working_rig(material.rig)
    except CalibrationError as error:
        yield Finding("error", str(error))
    stereo = report.stereo
    if is_swapped(report):
        yield Finding(
            "error",
            "left and right are swapped: points lie further right in the right image "
            f"({100 * (1 - report.stereo.positive):.0f} % of them)"
            if report.stereo
            else "",
            "swap the cameras and their calibration, or use --mode mono",
        )
    elif stereo is not None and stereo.rectified:
        if abs(stereo.row_offset_px) > _ROWS_APART_PX or stereo.row_spread_px > _ROWS_SPREAD_PX:
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


def _truth(report: Report) -> Iterator[Finding]:
    truth = report.truth
    if truth is not None and truth.covered < 0.5:
        yield Finding(
            "warning",
            f"the truth covers {100 * truth.covered:.0f} % of the images in time",
            "its clock may differ from the camera's",
        )


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers[:8])) + (", …" if len(numbers) > 8 else "")


def _command(report: Report, material: Material) -> str:
    """The run to try, with what this recording needs."""
    path = material.path
    words = ["vo", "run", str(path), "-o", f"out/{path.resolve().stem or 'run'}"]
    if not material.is_decided and len(report.cameras) > 1:
        words += ["--topic", f"left={report.cameras[0].name}"]
        words += ["--topic", f"right={report.cameras[1].name}"]
    if material.rig is None:
        words += ["--calibration", "camera.yaml"]
    elif any(finding for finding in _pair_errors(report, material)):
        words += ["--mode", "mono"]
    return shlex.join(words)


def _pair_errors(report: Report, material: Material) -> Iterator[Finding]:
    if report.calibration is not None and report.calibration.baseline_m is not None:
        yield from (each for each in _rig(report, material) if each.level == "error")
        if report.pair is not None and not report.pair.pairs:
            yield from _pair(report)
