"""Faults of a run as text: what was measured, where, what was done, what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from vo.base.faults import FaultKind
from vo.outputs.results.run_statistics import FaultRecord

# Texts with {frames} ("frame 7", "12 of the frames 7 to 30"), {value}, {size} (its magnitude) and
# {place} (", mostly at the bottom,").
# The first is used where all faults of the kind were handled, the second where one was not.
_TEXTS: Mapping[FaultKind, tuple[str, str]] = {
    FaultKind.IMAGE_FIXED_FEATURES: (
        "{value:.0%} of the image{place} does not move with the scene (the robot's own body, text, "
        "dirt, a dark border, or a reflection?) and is left out: {frames}; `masks.files` or "
        "`masks.ignore` leave it out from the start",
        "{value:.0%} of the image{place} does not move with the scene (the robot's own body, text, "
        "dirt, a dark border, or a reflection?), too much for the rest to decide: {frames}; leave "
        "it out by `masks.files` or `masks.ignore`, unless it is the scene",
    ),
    FaultKind.TWO_MOTIONS: (
        "two motions explain much of the image (a large moving object?); the path follows the one "
        "that continues: {frames}",
        "{value:.0%} of the map in view do not agree with the motion found: something large that "
        "moves may fill the image, and which motion is the camera's is uncertain: {frames}",
    ),
    FaultKind.BENT_MAP: (
        "{value:.0%} of the landmarks found are not where the map has them: {frames}",
        "{value:.0%} of the landmarks found are not where the map has them, which was right before "
        "(a quick or blurred turn?), so that scale and direction of the path may be wrong from "
        "there on: {frames}; turn more slowly, or record a second camera or an inertial sensor",
    ),
    FaultKind.CHANGING_APPEARANCE: (
        "{value:.0%} of the landmarks in view are not found again: {frames}",
        "{value:.0%} of the landmarks in view are not found where they should be, as the scene "
        "changes its look (light that moves, as under water, a screen, snow, or leaves?), so that "
        "the path is inaccurate: {frames}; record in steady light",
    ),
    FaultKind.REPEATED_IMAGES: (
        "images repeat the one before while the camera moves, and get no pose: {frames}; check the "
        "camera driver",
        "images repeat the one before while the camera moves: {frames}; check the camera driver",
    ),
    FaultKind.REPEATED_RIGHT_IMAGES: (
        "right images repeat the one before while the left ones change, and are not used: "
        "{frames}; check the camera driver",
        "right images repeat the one before while the left ones change: {frames}; check the "
        "camera driver",
    ),
    FaultKind.LEFT_CAMERA_ALONE: (
        "tracked with the left camera alone, as the right image did not agree: {frames}",
        "tracked with the left camera alone for too long to keep the scale: {frames}",
    ),
    FaultKind.RIGHT_CAMERA_ALONE: (
        "tracked with the right camera alone, as the left images are too faint (a fogged or dirty "
        "lens?): {frames}",
        "tracked with the right camera alone for too long to keep the scale: {frames}",
    ),
    FaultKind.CAMERA_LEFT_OUT: (
        "images of {cameras} are missing, covered, dark or frozen, up to {value:.0f} at a time, "
        "and left out: {frames}",
        "no camera of the rig has an image that could be used: {frames}",
    ),
    FaultKind.EXCHANGED_IMAGES: (
        "left and right images have changed places: {frames}",
        "left and right images have changed places: {frames}; lengths are wrong from there on; "
        "exchange the images of the frames that follow, or use `mode=mono`",
    ),
    FaultKind.BLURRED_IMAGES: (
        "images are blurred (blur {value:.2f} of 1): {frames}",
        "images are blurred (blur {value:.2f} of 1; sharp ones are below 0.4), so that the path is "
        "inaccurate: {frames}; check the focus, use shorter exposure, or move slower",
    ),
    FaultKind.FAINT_IMAGES: (
        "edges in the images are only {value:.1f} times as strong as the noise: {frames}",
        "edges in the images are only {value:.1f} times as strong as the noise (fog, a dirty or "
        "fogged lens, or too little light?), so that the path is inaccurate: {frames}; clean the "
        "lens, or give more light or a longer exposure",
    ),
    FaultKind.SMALL_IMAGES: (
        "images have only {value:.0f} thousand pixels: {frames}",
        "images have only {value:.0f} thousand pixels ({frames}), so that a pixel is a large angle "
        "and the path is several times as inaccurate as usual; record larger images, from 320 x "
        "240 on",
    ),
    FaultKind.INTERLACED_IMAGES: (
        "odd and even rows of images were taken at different times (interlaced video): {frames}",
        "odd and even rows of images were taken at different times (interlaced video; they "
        "alternate at up to {value:.1%} of the pixels), which bends what moves: {frames}; "
        "deinterlace the video first, or keep every second row (and halve fy and cy)",
    ),
    FaultKind.TORN_IMAGES: (
        "images are torn at a row: {frames}",
        "images are torn: from a row on they show another time or place than above it, in "
        "{value:.0%} of those examined (no vertical synchronisation, or lost rows?), so that the "
        "path is inaccurate: {frames}; record the images as the camera gives them, each complete",
    ),
    FaultKind.MISSING_ROWS: (
        "up to {value:.0%} of the rows of images are missing (of one grey, as a damaged stream "
        "leaves them) and are left out: {frames}",
        "up to {value:.0%} of the rows of images are missing (of one grey): {frames}",
    ),
    FaultKind.IMPLAUSIBLE_STEP: (
        "a step that neither the motion before nor that after supports gets no pose: {frames} "
        "(flicker, snow, or something that moves through the image?)",
        "a step of {size:.3g} times the usual one that neither the motion before nor that after "
        "supports: {frames}",
    ),
    FaultKind.RIGHT_TIME_OFFSET: (
        "right stamps are {value:+.1f} ms from left ones in all pairs, which is taken into account",
        "right images show the scene {value:+.0f} ms from the left ones of the same stamp, as rows "
        "that differ with the motion show: lengths are wrong; shift right stamps by {value:.0f} ms "
        "(`right_offset_ns`), and trigger the cameras together",
    ),
    FaultKind.WRONG_STEREO_CALIBRATION: (
        "the stereo calibration was wrong by {value:+.2f} px and has been corrected",
        "disparities and motion contradict each other by {value:+.1f} px, too much for a slightly "
        "wrong calibration, and this was not corrected: all lengths may be wrong; check focal "
        "length, baseline and image size (vo info shows them)",
    ),
    FaultKind.DIFFERENT_ROWS: (
        "rows of left and right images differed by up to {size:.1f} px and have been aligned",
        "rows of left and right images differ by up to {size:.1f} px, too much for a slightly "
        "wrong calibration, and were not aligned: lengths may be wrong: vo calibrate",
    ),
    FaultKind.WRONG_LENS: (
        "the lens differs from its calibration by {value:+.1f} px at the image's edges, and has "
        "been corrected",
        "the lens differs from its calibration by {value:+.1f} px at the image's edges, too much "
        "to correct; the path is inaccurate: vo calibrate",
    ),
    FaultKind.FOCAL_LENGTH_CHANGE: (
        "the focal length changed by up to {value:+.1%} (zoom or autofocus) and was followed: the "
        "images are used as at the longest one",
        "the focal length changed by {value:+.1%} or more during the recording (zoom, autofocus, "
        "or image stabilisation?), so that the path is wrong from there on: {frames}; switch zoom, "
        "autofocus and stabilisation off, or try `camera.focal=slow`",
    ),
    FaultKind.CLOCK_SET_BACK: (
        "the clock of the stamps was set back by {size:.3g} s; the order of the log is used, and "
        "later stamps are moved forward",
        "the clock of the stamps was set back by {size:.3g} s; check the clock of the recorder",
    ),
    FaultKind.IMPLAUSIBLE_RATE: (
        "the stamps say {size:.3g} images per second, which is implausible: are they in seconds? "
        "Times and speeds may be wrong, the path does not depend on them",
        "the stamps say {size:.3g} images per second, which is implausible: are they in seconds?",
    ),
    FaultKind.OTHER_STAMP_UNIT: (
        "the stamps are no seconds (images would be {size:.3g} s apart), and were read in the unit "
        "that fits",
        "the stamps are no seconds: images would be {size:.3g} s apart",
    ),
    FaultKind.INERTIAL_CONTRADICTION: (
        "the inertial sensor contradicts the images and is not used; the path is the same as with "
        "`inertial.enabled=false`",
        "the inertial sensor contradicts the images, and the path was made with both: run again "
        "with `inertial.enabled=false`",
    ),
}


def fault_warnings(records: Sequence[FaultRecord]) -> list[str]:
    """One sentence for each kind of fault."""
    return [_text(record) for record in records]


def _text(record: FaultRecord) -> str:
    handled, open_ = _TEXTS[record.kind]
    text = handled if record.is_handled else open_
    return text.format(
        frames=_frames(record),
        value=record.value,
        size=abs(record.value),
        cameras=record.place,
        place=f", mostly at the {record.place}," if record.place else "",
    )


def _frames(record: FaultRecord) -> str:
    first, last, count = record.first, record.last, record.frames
    if first is None or last is None:
        return "all frames"
    if first == last:
        return f"frame {first}"
    if count == last - first + 1:
        return f"frames {first} to {last}"
    return f"{count} of the frames {first} to {last}"
