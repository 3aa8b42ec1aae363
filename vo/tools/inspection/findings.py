"""Findings: problems of a recording, with advice."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from vo.base.printable import counted
from vo.base.types import Rig
from vo.recordings.formats.warning_kinds import WarningKind
from vo.tools.inspection.calibration_findings import calibration_findings, stereo_findings
from vo.tools.inspection.image_records import CameraReport, ImageStatistics
from vo.tools.inspection.images import frame_ranges
from vo.tools.inspection.imu_comparison import motion_findings
from vo.tools.inspection.inertial import imu_findings
from vo.tools.inspection.opening import OpenedRecording
from vo.tools.inspection.reports import Finding, Level, Report

_MIN_GREY = 25.0
_MAX_BRIGHT = 0.3
_MAX_BLUR = 0.62
_MIN_CORNERS = 150
_MAX_OFFSET_MS = 3.0
_MAX_LISTED = 8
_MAX_RANGES = 6
_REPORTED_HERE: frozenset[WarningKind] = frozenset(
    {"repeated_stamps", "unpaired_images", "large_baseline"}
)
"""Kinds of warnings of sources that are reported by findings of this module instead."""

_SEVERITY: dict[Level, int] = {"error": 0, "warning": 1, "note": 2}


def with_findings(report: Report, opened: OpenedRecording, imu_warnings: Sequence[str]) -> Report:
    """Add the findings, the most serious first, and the command to try."""
    findings = [*_refusal_finding(opened)]
    for camera in report.cameras:
        findings += [*_timing_findings(camera), *_image_findings(camera)]
    findings += _pair_findings(report)
    findings += calibration_findings(report, opened.rig, is_refused=bool(opened.refusal))
    findings += _truth_findings(report)
    for imu in report.imu:
        findings += [*imu_findings(imu), *motion_findings(imu)]
    findings += [Finding("warning", line) for line in imu_warnings]
    reported = " ".join(finding.what for finding in findings)
    findings += [
        Finding("warning", warning.text)
        for warning in opened.warnings
        if warning.kind not in _REPORTED_HERE and warning.text not in reported
    ]
    ordered = sorted(findings, key=lambda finding: _SEVERITY[finding.level])
    return replace(report, findings=tuple(ordered), command=_run_command(report, opened))


def _refusal_finding(opened: OpenedRecording) -> Iterator[Finding]:
    if opened.has_unknown_camera:
        yield Finding(
            "warning",
            "no calibration found: vo run estimates focal length and distortion from the images",
            "a calibration is better: `calibration=FILE` (format: docs/calibration.md)",
        )
    elif opened.refusal:
        yield Finding("error", opened.refusal.splitlines()[0])


def _timing_findings(camera: CameraReport) -> Iterator[Finding]:
    timing = camera.timing
    if timing.gaps:
        missing = sum(gap.missing for gap in timing.gaps)
        longest = max(timing.gaps, key=lambda gap: gap.seconds)
        yield Finding(
            "warning",
            f"{camera.name}: {counted(len(timing.gaps), 'gap')}, about "
            f"{counted(missing, 'image')} missing; the longest is "
            f"{longest.seconds:.3g} s after frame {longest.after_frame} ({longest.at_s:.2f} s)",
            "tracking may be lost there; `start` and `end` exclude such a part",
        )
    if timing.repeated_stamps:
        yield Finding(
            "warning",
            f"{camera.name}: {counted(timing.repeated_stamps, 'image')} not used: repeated stamps",
            "check for a node that publishes twice, or for merged bags",
        )
    interval_ms = 1000.0 / timing.rate_hz if timing.rate_hz else 0.0
    if timing.count > 2 and timing.jitter_ms > 0.2 * interval_ms:
        yield Finding(
            "note",
            f"{camera.name}: intervals vary by {timing.jitter_ms:.1f} ms around "
            f"{interval_ms:.1f} ms",
            "use the stamps of the camera driver, not the time of arrival",
        )


def _image_findings(camera: CameraReport) -> Iterator[Finding]:
    if not camera.looks:
        yield Finding("error", f"{camera.name}: no image can be read")
        return
    if camera.unreadable:
        yield Finding(
            "warning",
            f"{camera.name}: unreadable images: {_frames(camera.unreadable)}",
            "these frames are skipped",
        )
    if camera.other_sizes:
        yield Finding(
            "error",
            f"{camera.name}: images of other sizes than {camera.width}x{camera.height}: "
            f"{_frames(camera.other_sizes)}",
            "remove them, or split the recording by image size",
        )
    dark = [look for look in camera.looks if look.mean_grey < _MIN_GREY]
    bright = [look for look in camera.looks if look.bright > _MAX_BRIGHT]
    blurred = [look for look in camera.looks if look.blur > _MAX_BLUR and look not in dark]
    untextured = [look for look in camera.looks if look.corners < _MIN_CORNERS]
    repeats = [look for look in camera.looks if look.repeats]
    yield from _quality_finding(camera, dark, "dark", "use a larger aperture, or longer exposure")
    yield from _quality_finding(camera, bright, "over-exposed", "use automatic exposure")
    yield from _quality_finding(
        camera, blurred, "blurred", "use shorter exposure, check the focus, move slower"
    )
    yield from _quality_finding(
        camera, untextured, "nearly without texture", "tracking is difficult; see `picture`"
    )
    yield from _quality_finding(
        camera, repeats, "identical to the previous image", "remove them; check the camera driver"
    )


def _quality_finding(
    camera: CameraReport, looks: Sequence[ImageStatistics], what: str, advice: str
) -> Iterator[Finding]:
    if looks:
        frames = [look.frame for look in looks]
        parts = frame_ranges(frames, [look.frame for look in camera.looks])
        where = ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in parts[:_MAX_RANGES])
        more = ", …" if len(parts) > _MAX_RANGES else ""
        are, word = ("are", "frames") if len(frames) > 1 else ("is", "frame")
        yield Finding(
            "warning",
            f"{camera.name}: {len(looks)} of {len(camera.looks)} checked images {are} {what}: "
            f"{word} {where}{more}",
            advice,
        )


def _pair_findings(report: Report) -> Iterator[Finding]:
    pair = report.pair
    if pair is None:
        return
    if not pair.pairs:
        yield Finding(
            "error",
            f"no left image has a right image within {pair.tolerance_ms:.1f} ms; the nearest is "
            f"{pair.offset_ms:+.1f} ms away",
            "synchronise the clocks of the cameras, or use `mode=mono`",
        )
        return
    if pair.left_alone or pair.right_alone:
        yield Finding(
            "warning",
            f"{pair.left_alone} left and {pair.right_alone} right images have no counterpart",
            "the recorder dropped images, or the cameras are not triggered together",
        )
    if abs(pair.offset_ms) > _MAX_OFFSET_MS:
        yield Finding(
            "warning",
            f"right images are {pair.offset_ms:+.2f} ms later than left ones",
            "in motion this acts like a wrong baseline: trigger the cameras together",
        )


def _truth_findings(report: Report) -> Iterator[Finding]:
    truth = report.truth
    if truth is not None and truth.covered is not None and truth.covered < 0.5:
        yield Finding(
            "warning",
            f"the ground truth covers {100 * truth.covered:.0f} % of the images in time",
            "check whether both use the same clock",
        )


def _frames(numbers: Sequence[int]) -> str:
    return (
        ("frame " if len(numbers) == 1 else "frames ")
        + ", ".join(map(str, numbers[:_MAX_LISTED]))
        + (", …" if len(numbers) > _MAX_LISTED else "")
    )


def _run_command(report: Report, opened: OpenedRecording) -> str:
    """A `vo run` command with the options that this recording needs; empty if none can work."""
    if not any(camera.looks for camera in report.cameras):
        return ""
    path, options = opened.path, _without_missing_topics(opened)
    if options != list(opened.options):  # nothing else is known of it
        return shlex.join(["vo", "run", str(path), "-o", _output_of(path), *options])
    if not opened.roles_known and len(report.cameras) > 1:
        left, right = (camera.name for camera in report.cameras[:2])
        for number in reversed(range(len(options) - 1)):
            if options[number] == "--topic" and options[number + 1] in (left, right):
                del options[number : number + 2]
        options += ["--topic", f"left={left}", "--topic", f"right={right}"]
    if opened.has_unknown_camera:
        return shlex.join(["vo", "run", str(path), "-o", _output_of(path), *options])
    if opened.rig is None and "--calibration" not in options:
        options += ["--calibration", "camera.yaml"]
    elif report.stereo is not None and report.stereo.time_offset_ms is not None:
        if "--right-offset" not in options:
            options += ["--right-offset", f"{report.stereo.time_offset_ms:.0f}"]
    elif opened.rig is not None and "--mode" not in options:
        options += ["--mode", "mono"] if _is_pair_unusable(report, opened.rig) else []
    if opened.refusal and options == list(opened.options):
        return ""  # the same error again
    return shlex.join(["vo", "run", str(path), "-o", _output_of(path), *options])


def _output_of(path: Path) -> str:
    return f"out/{path.resolve().stem or 'run'}"


def _without_missing_topics(opened: OpenedRecording) -> list[str]:
    """The options without topics that the log does not have."""
    known = {topic.name.strip("/") for topic in opened.topics}
    options = list(opened.options)
    for number in reversed(range(len(options) - 1)):
        if options[number] != "--topic":
            continue
        if options[number + 1].rpartition("=")[2].strip("/") not in known:
            del options[number : number + 2]
    return options


def _is_pair_unusable(report: Report, rig: Rig) -> bool:
    """Whether the pair has errors, so that the left camera alone is better."""
    if not rig.is_stereo:
        return False
    found = list(stereo_findings(report, rig))
    if report.pair is not None and not report.pair.pairs:
        found += _pair_findings(report)
    return any(each.level == "error" for each in found)
