"""Inspection report as text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from vo.base.printable import counted
from vo.cli.console import standard_output
from vo.tools.inspection.image_records import CameraReport, PairReport
from vo.tools.inspection.reports import (
    CalibrationReport,
    Finding,
    ImuMotionReport,
    ImuReport,
    LensReport,
    MountReport,
    Report,
)

_WORDS = {
    "error": "[bold red]problem:[/]",
    "warning": "[yellow]warning:[/]",
    "note": "[dim]note:[/]",
}
_BAR = 24
_MIN_TURN_DEG = 10.0  # smaller rotations between the cameras are usual


def print_report(report: Report, sheet: Path | None, console: Console | None = None) -> None:
    """Print facts, findings, and the command to try."""
    console = console or standard_output()
    for name, value in _facts(report):
        console.print(f"[bold]{name:<11}[/]", escape(value), soft_wrap=True)
    if sheet is not None:
        console.print(f"[bold]{'images':<11}[/]", escape(str(sheet)), soft_wrap=True)
    print_findings(report.findings, console)
    if not report.findings:
        console.print("[green]no problems found[/]")
    if report.command:
        console.print("[cyan]try:[/]", escape(report.command), soft_wrap=True)


def print_findings(findings: Iterable[Finding], console: Console) -> None:
    """Print what was found, with advice."""
    for finding in findings:
        advice = f"; {finding.advice}" if finding.advice else ""
        console.print(_WORDS[finding.level], escape(finding.what + advice), soft_wrap=True)


def _facts(report: Report) -> Iterator[tuple[str, str]]:
    yield "recording", f"{report.path} ({report.format})"
    width = max((len(topic.name) for topic in report.topics), default=0)
    for number, topic in enumerate(report.topics):
        rate = f"{topic.rate_hz:.1f} Hz" if topic.rate_hz else ""
        line = f"{topic.name:<{width}}  {topic.count:>7}  {rate:>9}  {topic.schema}"
        if not topic.is_read:
            line += " (not read by vo)" if topic.count else " (no messages)"
        yield "" if number else "topics", line
    for camera in report.cameras:
        yield camera.name, _camera(camera)
        yield "", _image_quality(camera)
    if report.clip:
        yield "camera", ", ".join(report.clip)
    if report.pair is not None:
        yield from _pair(report.pair)
    if report.calibration is None:
        yield "calibration", "none found"
    else:
        yield "calibration", report.calibration.source or "in the recording"
    if report.calibration is not None:
        for lens in report.calibration.lenses:
            yield "", _lens(lens)
        mounts = report.calibration.mounts
        if report.calibration.baseline_m is not None and (not mounts or report.pair is not None):
            yield "", _baseline(report.calibration)
        for number, mount in enumerate(mounts):
            yield "" if number else "rig", _mount(mount)
    yield from _measured(report)
    if report.has_depth:
        yield "depth", "aligned with cam0"
    yield "truth", _truth(report)
    if report.pose_topics:
        yield "poses", ", ".join(report.pose_topics) + " (for vo eval --topic)"
    for imu in report.imu:
        yield "imu", _imu(imu)
        yield "", _motion(imu)
        if imu.motion is not None and imu.motion.fits:
            yield "", _compared(imu.motion)


def _truth(report: Report) -> str:
    truth = report.truth
    if truth is None:
        return "none found"
    images = "" if truth.covered is None else f", covers {100 * truth.covered:.0f} % of the images"
    return (
        f"{counted(truth.poses, 'pose')}, {truth.span_s:.2f} s at {truth.rate_hz:.3g} Hz, "
        f"{truth.path_m:.1f} m of path{images}"
    )


def _imu(imu: ImuReport) -> str:
    gaps = {0: "no gaps", 1: "1 gap"}.get(imu.gaps, f"{imu.gaps} gaps")
    covered = "" if imu.covered is None else f", covers {100 * imu.covered:.0f} % of the images"
    return (
        f"{imu.name}: {counted(imu.count, 'sample')}, {imu.span_s:.2f} s at {imu.rate_hz:.4g} Hz, "
        f"{gaps}{covered}"
    )


def _compared(motion: ImuMotionReport) -> str:
    error = motion.rotation_error_deg
    pose = "" if error is None else f"; orientation within {error:.1f} degrees of cam0_from_imu"
    return (
        f"{counted(motion.compared, 'rotation')} of images compared: time offset "
        f"{motion.time_offset_ms:+.1f} ± {motion.time_offset_sd_ms:.1f} ms{pose}"
    )


def _motion(imu: ImuReport) -> str:
    transform = "unknown" if imu.cam0_from_imu is None else "known"
    noise = "unknown (taken as that of a consumer sensor)" if imu.noise is None else "known"
    return (
        f"{imu.looked_at} checked: mean acceleration {imu.accel_m_s2:.4g} m/s², median rate "
        f"{imu.gyro_rad_s:.3g} rad/s; cam0_from_imu {transform}, noise {noise}"
    )


def _camera(camera: CameraReport) -> str:
    timing = camera.timing
    bits = (", colour" if camera.has_colour else "") + (
        "" if camera.bits == 8 else f", {camera.bits} bits"
    )
    rate = f"{timing.rate_hz:.4g} Hz (± {timing.jitter_ms:.2g} ms)" if timing.rate_hz else "no rate"
    gaps = {0: ", no gaps", 1: ", 1 gap"}.get(len(timing.gaps), f", {len(timing.gaps)} gaps")
    size = f"{camera.width}x{camera.height}" if camera.width else "size unknown"
    return f"{counted(timing.count, 'image')}, {size}{bits}, {timing.span_s:.2f} s at {rate}{gaps}"


def _image_quality(camera: CameraReport) -> str:
    looks = camera.looks
    if not looks:
        return "no image is readable"
    greys = sorted(look.mean_grey for look in looks)
    blurs = sorted(look.blur for look in looks)
    corners = sorted(look.corners for look in looks)
    middle = len(looks) // 2
    return (
        f"{len(looks)} checked: grey {greys[0]:.0f} to {greys[-1]:.0f}, blur "
        f"{blurs[middle]:.2f} (0 sharp, 1 blurred), {corners[0]} to {corners[-1]} corners"
    )


def _pair(pair: PairReport) -> Iterator[tuple[str, str]]:
    low, high = pair.offsets_ms
    yield (
        "pairs",
        f"{pair.pairs}, {pair.left_alone} left and {pair.right_alone} right images unpaired; right "
        f"minus left {low:+.3f} to {high:+.3f} ms, median {pair.offset_ms:+.3f} ms",
    )
    if len(pair.histogram) > 1:
        most = max(count for _, count in pair.histogram)
        for edge, count in pair.histogram:
            bar = "█" * round(_BAR * count / most) or ("▏" if count else "")
            yield "", f"{edge:+8.3f} ms {count:>6} {bar}"


def _lens(lens: LensReport) -> str:
    views = " x ".join("undefined" if v is None else f"{v:.0f}°" for v in lens.view_deg)
    shutter = f", rows read within {1e3 * lens.readout_s:.3g} ms" if lens.readout_s else ""
    return (
        f"{lens.name}: focal length {lens.fx:.1f}, {lens.fy:.1f} px, principal point "
        f"{lens.cx:.1f}, {lens.cy:.1f} of {lens.width}x{lens.height}, field of view {views}, "
        f"distortion {lens.model}{shutter}"
    )


def _baseline(calibration: CalibrationReport) -> str:
    parts = [f"baseline {calibration.baseline_m:.4g} m"]
    if calibration.cam1_is not in (None, "right"):
        to_the = {"left": "to the left of", "in front": "in front of"}
        place = to_the.get(str(calibration.cam1_is), calibration.cam1_is)
        parts.append(f"cam1 is {place} cam0")
    turned_deg = calibration.cam1_turned_deg
    if turned_deg is not None and turned_deg >= _MIN_TURN_DEG:
        parts.append(f"cam1 is turned by {turned_deg:.0f}° against cam0")
    parts.append("rectified" if calibration.is_rectified else "not rectified")
    return ", ".join(parts)


def _mount(mount: MountReport) -> str:
    seen = ", ".join(f"{name} sees {100 * r:.0f} %" for name, r in mount.overlaps.items())
    return (
        f"{mount.name}: {mount.from_cam0_m:.3g} m from cam0, turned by {mount.turned_deg:.0f}°; "
        f"of its image {seen or 'the others see nothing'}"
    )


def _measured(report: Report) -> Iterator[tuple[str, str]]:
    stereo = report.stereo
    if stereo is not None:
        depth = "" if stereo.depth_m is None else f" (depth {stereo.depth_m:.3g} m)"
        kind = "rectified images" if stereo.rectified else "original images"
        yield (
            "measured",
            f"{kind}: rows differ by {stereo.row_offset_px:+.2f} ± {stereo.row_spread_px:.2f} px, "
            f"disparity {stereo.disparity_px:.1f} px{depth} "
            f"(medians of {counted(stereo.matches, 'point')} in {counted(stereo.pairs, 'pair')})",
        )
