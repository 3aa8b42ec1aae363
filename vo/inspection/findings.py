"""What is wrong with a recording, and what to do about it."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace

from vo.inspection.calibration_findings import in_calibration, in_pair
from vo.inspection.inertial import in_imu
from vo.inspection.material import Material
from vo.inspection.pictures import stretches
from vo.inspection.records import CameraReport, Finding, Level, Look, Report
from vo.types import Rig

_DARK_GREY = 25.0
_BRIGHT_SHARE = 0.3
_BLURRED = 0.62
_FEW_CORNERS = 150
_OFFSET_MS = 3.0
_SAID_BETTER = ("have no left partner", "images repeat a stamp", "if that is millimetres")
"""In warnings of sources that come as findings of our own."""

_SEVERITY: dict[Level, int] = {"error": 0, "warning": 1, "note": 2}


def find_all(report: Report, material: Material, said_of_imus: Sequence[str]) -> Report:
    """The report with its findings, the most serious first, and the command to try.

    Args:
        report: all but these.
        material: the recording.
        said_of_imus: warnings of its inertial sensors.
    """
    findings = [*_refusal(material)]
    for camera in report.cameras:
        findings += [*_time(camera), *_images(camera)]
    findings += [*_pair(report), *in_calibration(report, material.rig), *_truth(report)]
    for imu in report.imu:
        findings += in_imu(imu)
    findings += [Finding("warning", line) for line in said_of_imus]
    said = " ".join(finding.what for finding in findings)
    findings += [
        Finding("warning", line)
        for line in material.warnings
        if line not in said and not any(known in line for known in _SAID_BETTER)
    ]
    ordered = sorted(findings, key=lambda finding: _SEVERITY[finding.level])
    return replace(report, findings=tuple(ordered), command=_command(report, material))


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
    if not report.cameras:  # what is wrong comes first
        return shlex.join(words)
    if material.rig is None:
        words += ["--calibration", "camera.yaml"]
    elif _pair_is_wrong(report, material.rig):
        words += ["--mode", "mono"]
    return shlex.join(words)


def _pair_is_wrong(report: Report, rig: Rig) -> bool:
    """Whether the left camera alone promises more."""
    if not rig.is_stereo:
        return False
    found = list(in_pair(report, rig))
    if report.pair is not None and not report.pair.pairs:
        found += _pair(report)
    return any(each.level == "error" for each in found)
