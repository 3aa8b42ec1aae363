"""Faults of a recording that can make the path wrong, as detectors report them."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class FaultKind(StrEnum):
    """What is wrong; the value is its name in files."""

    IMAGE_FIXED_FEATURES = "image_fixed_features"
    TWO_MOTIONS = "two_motions"
    BENT_MAP = "bent_map"
    CHANGING_APPEARANCE = "changing_appearance"
    REPEATED_IMAGES = "repeated_images"
    REPEATED_RIGHT_IMAGES = "repeated_right_images"
    LEFT_CAMERA_ALONE = "left_camera_alone"
    RIGHT_CAMERA_ALONE = "right_camera_alone"
    CAMERA_LEFT_OUT = "camera_left_out"
    EXCHANGED_IMAGES = "exchanged_images"
    INTERLACED_IMAGES = "interlaced_images"
    TORN_IMAGES = "torn_images"
    MISSING_ROWS = "missing_rows"
    BLURRED_IMAGES = "blurred_images"
    FAINT_IMAGES = "faint_images"
    SMALL_IMAGES = "small_images"
    IMPLAUSIBLE_STEP = "implausible_step"
    RIGHT_TIME_OFFSET = "right_time_offset"
    WRONG_STEREO_CALIBRATION = "wrong_stereo_calibration"
    DIFFERENT_ROWS = "different_rows"
    WRONG_LENS = "wrong_lens"
    FOCAL_LENGTH_CHANGE = "focal_length_change"
    CLOCK_SET_BACK = "clock_set_back"
    IMPLAUSIBLE_RATE = "implausible_rate"
    OTHER_STAMP_UNIT = "other_stamp_unit"
    INERTIAL_CONTRADICTION = "inertial_contradiction"


class Fault(NamedTuple):
    """A fault in one frame, or in a whole recording.

    Attributes:
        is_handled: whether its effect was removed or bounded, so that the path can be trusted;
            False if the path may be wrong.
        value: size of the fault, in the unit of its message.
        place: where it lies in the image, such as `bottom left`, or the cameras of a rig, such as
            `cam0, cam2`; empty if that does not apply.
    """

    kind: FaultKind
    is_handled: bool = False
    value: float = 0.0
    place: str = ""
