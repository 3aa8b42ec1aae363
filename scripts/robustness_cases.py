"""The situations of the table of robustness: which fault, in which strengths, on which clip."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import robustness_faults as faults
import robustness_optics as optics
import robustness_overlays as overlays
from robustness_clips import Fault, write_euroc
from robustness_logs import Write, clock_set_back, times_in
from robustness_run import FLOOR_RATIO

CLIPS = (
    "kitti06 stereo",
    "kitti07 mono",
    "kitti_raw stereo",
    "kitti_raw mono",
    "hall stereo",
    "hall mono",
    "room stereo",
)
_LESS_ACCURATE = 0.003  # of the path: images that show less, and still give a good path
PERCENT = (10, 20, 30, 40, 60)


@dataclass(frozen=True)
class Case:
    """One row of the table."""

    situation: str  # what is wrong with the recording
    variant: str
    clip: str  # the clean recording and the mode, `hall stereo`
    fault: Fault  # makes the faulty recording of the clean one
    write: Write = write_euroc  # writes it, and gives the path to run on
    is_quick: bool = False  # whether the row belongs to the quick selection
    # whether the fault shows in the images at all; if not, no program can detect it
    is_visible: bool = True
    # Ratio of the path that counts as right at least
    floor_ratio: float = FLOOR_RATIO

    @property
    def name(self) -> str:
        """Situation, variant and clip, as `--only` compares them."""
        return f"{self.situation}, {self.variant}, {self.clip}"


def cases(vo: Path) -> list[Case]:
    """All rows; `vo` is the command that converts recordings."""
    groups = (_still, _moving, _repeated, _pairs, _calibrations, _sensors, _weather, _optics)
    return [case for group in groups for case in group()] + list(_stamps(vo))


def _shares(
    situation: str, clip: str, fault: object, quick: Sequence[int] = (30,)
) -> Iterator[Case]:
    """A row for each share of the image that a fault covers."""
    for percent in PERCENT:
        made = fault(percent / 100)  # type: ignore[operator]
        yield Case(situation, f"{percent} %", clip, made, is_quick=percent in quick)


def _still() -> Iterator[Case]:
    """Content that stands still in the image."""
    yield from _shares("bonnet", "kitti07 mono", lambda s: overlays.own_body(s, False))
    yield from _shares("bonnet", "kitti06 stereo", lambda s: overlays.own_body(s, False), ())
    yield from _shares("bumper", "hall stereo", lambda s: overlays.own_body(s, False), ())
    yield from _shares("textured body", "hall stereo", lambda s: overlays.own_body(s, True))
    yield from _shares("textured body", "kitti07 mono", lambda s: overlays.own_body(s, True), ())
    yield from _shares("burnt-in text", "kitti07 mono", overlays.burnt_in_text)
    yield from _shares("burnt-in text", "hall stereo", overlays.burnt_in_text, ())
    yield from _shares("reflection", "kitti07 mono", overlays.reflection)
    yield from _shares("reflection", "kitti06 stereo", overlays.reflection, ())
    for dots in (500, 1500, 3000):
        fault = overlays.projected_dots(dots)
        yield Case("IR dots", f"{dots}", "room stereo", fault, is_quick=dots == 1500)
    fault = overlays.projected_dots(1500, every=2)
    yield Case("IR dots", "1500, every second frame", "room stereo", fault)


def _moving() -> Iterator[Case]:
    """A large thing that moves."""
    for clip in ("kitti06 stereo", "kitti07 mono", "hall stereo"):
        yield Case("standing", "0 %", clip, faults.standing)
    for clip in ("kitti06 stereo", "hall stereo"):
        for percent in PERCENT:
            train = overlays.train(percent / 100)
            quick = percent == 60
            fault = faults.chain(faults.standing, train)
            yield Case("train, camera stands", f"{percent} %", clip, fault, is_quick=quick)
            there = faults.chain(faults.standing, overlays.train(percent / 100, 12.0, first=-150))
            yield Case("train there from the start, camera stands", f"{percent} %", clip, there)
    for clip in ("kitti06 stereo", "kitti07 mono", "hall stereo"):
        yield from _shares("train, camera moves", clip, overlays.train, ())
        for px in (6.0, 25.0):
            slower = overlays.train(0.6, px)
            yield Case(f"train of {px:.0f} px a frame, camera moves", "60 %", clip, slower)


def _repeated() -> Iterator[Case]:
    """Images that freeze."""
    for frames in (3, 10, 30, 60):
        fault = faults.frozen(90, frames)
        quick = frames == 30
        yield Case("frozen", f"{frames} frames", "hall stereo", fault, is_quick=quick)
    for sigma in (0.5, 2.0, 5.0):
        fault = faults.frozen(90, 30, noise=sigma)
        yield Case("frozen, noise added", f"σ = {sigma:g}", "hall stereo", fault)
    for frames in (1, 5, 15):
        yield Case("frozen", f"{frames} frames", "kitti06 stereo", faults.frozen(20, frames))
    for frames in (5, 15):
        yield Case("frozen", f"{frames} frames", "kitti07 mono", faults.frozen(50, frames))
    yield Case("frozen", "30 frames", "hall mono", faults.frozen(90, 30))
    for frames in (10, 30, 100):
        fault = faults.frozen(99, frames, cameras=(1,))
        quick = frames == 100
        yield Case("frozen right", f"{frames} frames", "hall stereo", fault, is_quick=quick)
    fault = faults.frozen(20, 30, cameras=(1,))
    yield Case("frozen right", "30 frames", "kitti06 stereo", fault)
    fault = faults.frozen(99, 100, cameras=(1,), noise=2.0)
    yield Case("frozen right", "100 frames, noise", "hall stereo", fault)
    yield Case("frozen left", "30 frames", "hall stereo", faults.frozen(90, 30, cameras=(0,)))


def _pairs() -> Iterator[Case]:
    """Left and right exchanged, turned, at other times, or mounted in other ways."""
    for clip in ("hall stereo", "kitti06 stereo", "kitti_raw stereo"):
        yield Case("swapped", "left and right", clip, faults.swapped, is_quick=clip[0] == "h")
    for clip in ("hall stereo", "kitti06 stereo"):
        yield Case("inverted", "both by 180°", clip, faults.inverted)
        yield Case("mirrored", "both", clip, faults.mirrored)
        yield Case("same camera twice", "left", clip, faults.same_camera)
    for clip in ("hall stereo", "kitti06 stereo", "kitti_raw stereo"):
        for frames in (1, 2):
            fault, quick = faults.late(frames), frames == 1 and clip[0] == "h"
            yield Case("right late", f"{frames} frames", clip, fault, is_quick=quick)
    yield Case("left late", "1 frame", "hall stereo", faults.late(1, camera=0))
    for offset_ms in (-40, 3, 20, 45, 120):
        fault = faults.stamp_offset(offset_ms)
        yield Case("right stamps off", f"{offset_ms:+d} ms", "hall stereo", fault)
    for degrees in (10, 90, 100, 180):
        fault, quick = faults.rolled(degrees), degrees == 180
        yield Case("right rolled", f"{degrees}°", "hall stereo", fault, is_quick=quick)
    yield Case("vertical pair", "cam1 below", "hall stereo", faults.vertical, is_quick=True)
    yield Case("cameras apart", "90°", "hall stereo", faults.apart(90.0), is_quick=True)
    for camera, side in ((1, "right"), (0, "left")):
        fault = faults.covered(60, 60, camera)
        yield Case(f"{side} covered", "60 frames", "hall stereo", fault)
        yield Case(f"{side} missing", "60 frames", "hall stereo", faults.failing(60, 60, camera))
    yield Case("right covered", "from the start, 60", "hall stereo", faults.covered(0, 60))
    yield Case("right covered", "15 frames", "kitti06 stereo", faults.covered(20, 15))
    yield Case("right covered", "all", "hall stereo", faults.covered(0, 10_000))


def _calibrations() -> Iterator[Case]:
    """Calibrations that are off."""
    for name in ("pitch", "yaw", "roll"):
        for degrees in (0.05, 0.2, 0.5, 2.0):
            for clip in ("hall stereo", "kitti06 stereo"):
                fault = faults.miscalibrated(**{name: degrees})
                yield Case(f"right {name} off", f"{degrees:g}°", clip, fault)
    yield Case("right yaw off", "-0.5°", "hall stereo", faults.miscalibrated(yaw=-0.5))
    yield Case("right yaw off", "0.2°", "kitti_raw stereo", faults.miscalibrated(yaw=0.2))
    for degrees in (0.5, 2.0, 10.0):
        fault = faults.miscalibrated(down=degrees)
        yield Case("baseline tilted", f"{degrees:g}°", "hall stereo", fault)
    fault = faults.miscalibrated(baseline=1.05)
    yield Case("baseline too long", "5 %", "hall stereo", fault, is_visible=False)
    quick = True
    for kept in (0.0, 0.5, 0.9):
        fault, text = faults.without_distortion(kept), f"{100 * kept:g} % of it kept"
        yield Case("distortion dropped", text, "kitti_raw mono", fault, is_quick=quick)
        yield Case("distortion dropped", text, "kitti_raw stereo", fault)
        quick = False


def _sensors() -> Iterator[Case]:
    """Readout, range and size of images."""
    for percent in (10, 30, 60):
        for cycles in (3.33, 4.1):
            fault, text = faults.flicker(percent / 100, cycles), f"{percent} %, {cycles:g} cycles"
            quick = percent == 30 and cycles < 4
            yield Case("row flicker", text, "hall stereo", fault, is_quick=quick)
    yield Case("row flicker", "60 %, 3.33 cycles", "kitti07 mono", faults.flicker(0.6))
    for counts in (100, 500, 3000):
        fault, quick = faults.thermal(counts), counts == 500
        yield Case("16 bits", f"{counts} counts", "hall stereo", fault, is_quick=quick)
    yield Case("16 bits", "500 counts", "kitti07 mono", faults.thermal(500))
    for clip in ("hall stereo", "kitti07 mono"):
        yield Case("interlaced", "all", clip, faults.interlaced, is_quick=clip[0] == "h")
    for clip, factor in (("hall stereo", 0.25), ("kitti06 stereo", 0.13), ("kitti07 mono", 0.13)):
        yield Case("tiny", f"{factor:.0%} of the size", clip, faults.resized(factor))


def _weather() -> Iterator[Case]:
    """Light, weather and blur."""
    for clip in ("hall stereo", "kitti06 stereo", "kitti07 mono"):
        for factor in (0.2, 0.05):
            yield Case("night", f"light × {factor:g}", clip, faults.night(factor))
        for flakes in (100, 600):
            yield Case("snow", f"{flakes} flakes", clip, faults.snow(flakes))
        for length in (7, 21):
            yield Case("blur", f"{length} px", clip, faults.blur(length))


def _optics() -> Iterator[Case]:
    """What happens before the lens, in it, and between the cameras."""
    found = (
        ("water drop", "radius 60 px", optics.water_drop(80, 60)),
        ("water drop", "radius 110 px", optics.water_drop(80, 110)),
        ("wiper", "every 1.5 s", optics.wiper),
        ("LED light", "50 %", optics.led_light(0.5)),
        ("rows lost", "4 of every third image", optics.lost_rows(4)),
        ("rows lost", "40 of every third image", optics.lost_rows(40)),
        ("lens flare", "4 ghosts", optics.flare),
        ("mirror wall", "50 %", optics.mirror_wall(0.5)),
        ("mirror wall", "90 %", optics.mirror_wall(0.9)),
        ("stamps late by chance", "σ = 10 ms", optics.jitter(10.0)),
        ("long exposure", "3 images", optics.long_exposure),
        ("head lamp", "at night", optics.head_lamp),
        ("rain", "300 streaks", optics.rain(300)),
        ("JPEG", "quality 5", optics.jpeg(5)),
        ("own shadow", "at the bottom", optics.own_shadow),
        ("window of a train", "33 % of the image", optics.window_of_a_train),
    )
    for situation, variant, fault in found:
        for clip in ("hall stereo", "hall mono"):
            yield Case(situation, variant, clip, fault, floor_ratio=_LESS_ACCURATE)
    yield Case("half a frame apart", "10 Hz", "hall stereo", optics.half_a_frame_apart)


def _stamps(vo: Path) -> Iterator[Case]:
    """Times of images."""

    def same(clip):  # type: ignore[no-untyped-def]
        return clip

    for clip in ("kitti07 mono", "hall stereo"):
        write = clock_set_back(vo, 3.0, 50)
        quick = clip[0] == "k"
        yield Case("clock set back", "3 s, MCAP", clip, same, write, is_quick=quick)
    for unit, factor in (("ms", 1e3), ("ns", 1e9)):
        yield Case("times in other units", unit, "kitti06 stereo", same, times_in(factor))
