"""Cameras of a log, from its calibration messages and its frames."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vo.base.errors import CalibrationError, NoCalibration, VoError
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Camera, Floats
from vo.recordings.formats.calibration.checks import check_baseline, checks_log, matrix_camera
from vo.recordings.formats.calibration.document import ImageSize
from vo.recordings.formats.camera_messages import UNCALIBRATED
from vo.recordings.formats.messages import CalibrationMessage
from vo.recordings.formats.warning_kinds import warned_once, warning_kind
from vo.recordings.sources.logs.choice import base_name
from vo.recordings.sources.logs.frame_tree import FrameTree
from vo.recordings.sources.logs.log import Entry, Log, Topic
from vo.recordings.sources.logs.realsense_bag import stream_of

_ADVICE = "give a file with `calibration=FILE`"
_MAX_MESSAGES = 100
_MIN_ZOOM = 0.01  # smaller changes of the focal length are estimates
_log = logging.getLogger(__name__)
_MIN_COSINE = 0.5  # of the angle between optical axes


@dataclass(frozen=True, eq=False)
class LogCamera:
    """A camera of a log.

    Attributes:
        frame: its coordinate frame, that of its first image.
        calibration: the calibration of most of its messages.
        is_rectified: whether its images are rectified, and thus without distortion.
    """

    topic: str
    frame: str
    calibration: CalibrationMessage
    is_rectified: bool

    @property
    def camera(self) -> Camera:
        """Intrinsics of the images."""
        camera, p = self.calibration.camera, self.calibration.projection
        if not self.is_rectified:
            return camera
        where, size = f"P of the calibration of {self.topic}", (camera.width, camera.height)
        return matrix_camera(
            where, resolution=size, matrix=p[:, :3].tolist(), distortion_model="none", distortion=()
        )


def find_camera(
    log: Log,
    image: Topic,
    frame: str,
    calibrations: Sequence[Topic],
    entries: Mapping[str, Sequence[Entry]],
) -> LogCamera:
    """Find the calibration of an image topic, by topic name or else by frame."""
    space, _, last = base_name(image.name).rpartition("/")
    same = [t for t in calibrations if t.name.rpartition("/")[0] in (space, f"{space}/{last}")]
    if stream := stream_of(image.name):
        same = [t for t in calibrations if stream_of(t.name) == stream]
    by_name = same if len(same) == 1 else []
    reason = ""
    by_frame: list[tuple[Topic, list[CalibrationMessage]]] = []
    for topic in [*by_name, *(t for t in calibrations if t not in by_name)]:
        try:
            with warned_once(checks_log):
                messages = _messages(log, topic, entries[topic.name], is_rectified="rect" in last)
        except VoError as error:
            if topic in by_name:
                advice = "" if "calibration=" in str(error) else f"; {_ADVICE}"
                kind = NoCalibration if UNCALIBRATED in str(error) else CalibrationError
                raise kind(f"{topic.name}: {error}{advice}") from error
            reason = reason or f"; {topic.name}: {error}"
            continue
        if topic in by_name or (frame and _usual(messages).frame == frame):
            by_frame.append((topic, messages))
        if topic in by_name:
            break
    if by_frame:
        topic, messages = by_frame[0]
        found = _usual(messages)
        for other, others in by_frame[1:]:
            if _values(_usual(others)) != _values(found):
                raise CalibrationError(
                    f"{topic.name} and {other.name} both are of frame '{frame}', that of "
                    f"{image.name}, and differ; {_ADVICE}"
                )
        _warn_of_changes(topic, found, messages)
        return LogCamera(image.name, frame or found.frame, found, "rect" in last)
    known = ", ".join(topic.name for topic in calibrations) or "none"
    missing = CalibrationError if calibrations else NoCalibration
    raise missing(
        f"no calibration for {image.name} in the log (topics with calibrations: {known}{reason}); "
        f"{_ADVICE} (format: docs/calibration.md)"
    )


def cam1_from_cam0(
    left: LogCamera, right: LogCamera, frames: FrameTree, *, may_be_apart: bool = False
) -> Floats:
    """Extrinsics of the right camera, from the frame tree or from the rectification.

    `may_be_apart`: whether the cameras may look in any directions; else they must suit a pair.
    """
    by_projection = _from_projections(left, right)
    by_frames = None
    if left.frame and right.frame and left.frame != right.frame:
        by_frames = frames.between(right.frame, left.frame)
    # Frames are those of the physical cameras; rectified cameras are rotated.
    first, second = by_frames, by_projection
    if left.is_rectified and right.is_rectified:
        first, second = second, first
    found = first if first is not None else second
    if found is None:
        raise CalibrationError(
            f"unknown pose of {right.topic} relative to {left.topic}: no transforms connect frame "
            f"'{left.frame}' to '{right.frame}', and {_no_shift(left, right)}; "
            "give a file with `calibration=FILE`, or use `mode=mono`"
        )
    if are_apart([np.eye(4), found]):
        if may_be_apart:
            return np.asarray(inverse(cam0_from_cam(left, right, frames)))
        angle_deg = np.degrees(np.arccos(max(float(found[2, 2]), -1.0)))
        raise CalibrationError(
            f"the optical axes of {left.topic} and {right.topic} differ by {angle_deg:.0f} "
            "degrees, too much for a stereo pair; choose other topics, or one with `topics`"
        )
    check_baseline(f"{left.topic} and {right.topic}", found)
    if found is by_projection and found[0, 3] > 0.0:
        _log.warning(
            "%s: by P the camera is to the left of %s: the last column of a right camera is "
            "negative, -fx times the baseline",
            right.topic,
            left.topic,
        )
    return found


def are_apart(cam0_from_cams: Sequence[Floats]) -> bool:
    """Whether two cameras look in directions too different for a pair."""
    return len(cam0_from_cams) == 2 and float(cam0_from_cams[1][2, 2]) < _MIN_COSINE


def cam0_from_cam(first: LogCamera, camera: LogCamera, frames: FrameTree) -> Floats:
    """Pose (4, 4) of the images of a camera of a rig relative to those of the first."""
    if camera is first:
        return np.eye(4)
    known = None
    if first.frame and camera.frame and first.frame != camera.frame:
        known = frames.between(first.frame, camera.frame)
    if known is None:
        raise CalibrationError(
            f"no transforms connect its frame '{camera.frame}' to '{first.frame}'; {_ADVICE}"
        )
    # Frames are those of the physical cameras; rectified cameras are rotated.
    turns = [
        make_transform(each.calibration.rectified_from_cam, np.zeros(3))
        if each.is_rectified
        else np.eye(4)
        for each in (first, camera)
    ]
    return np.asarray(turns[0] @ known @ inverse(turns[1]))


def _from_projections(left: LogCamera, right: LogCamera) -> Floats | None:
    """cam1_from_cam0 from the last columns of the rectified projections P = K [I | t]."""
    shift = _offset(right) - _offset(left)
    if not np.any(shift):
        return None
    rectified = make_transform(np.eye(3), shift)
    if left.is_rectified and right.is_rectified:
        return rectified
    # p_rectified = R p, so cam1_from_cam0 = R1^-1 [I | shift] R0.
    turn_left = make_transform(left.calibration.rectified_from_cam, np.zeros(3))
    turn_right = make_transform(right.calibration.rectified_from_cam, np.zeros(3))
    return np.asarray(inverse(turn_right) @ rectified @ turn_left)


def _no_shift(left: LogCamera, right: LogCamera) -> str:
    """Why the projections say nothing about the baseline."""
    length_m = float(np.linalg.norm(_offset(right)))
    if length_m == 0.0:
        return "the last column of the right camera's P is 0"
    return (
        f"P of both have the same last column ({left.calibration.projection[0, 3]:g}), where that "
        f"of the left one must be 0 (then the baseline would be {length_m:g} m)"
    )


def _offset(camera: LogCamera) -> Floats:
    p = camera.calibration.projection
    if abs(np.linalg.det(p[:, :3])) < 1e-9:
        raise CalibrationError(f"the projection P of {camera.topic} cannot be inverted")
    return np.asarray(np.linalg.solve(p[:, :3], p[:, 3]))


def _messages(
    log: Log, topic: Topic, entries: Sequence[Entry], *, is_rectified: bool
) -> list[CalibrationMessage]:
    """The readable messages of a camera, about 100 of all."""
    found, reason = [], ""
    for entry in entries[:: 1 + len(entries) // _MAX_MESSAGES]:
        try:
            message = topic.codec.decode(log.read(entry))
        except VoError as error:
            reason = reason or f": {error}"
            continue
        if not isinstance(message, CalibrationMessage):
            continue
        if message.is_rectified_only and not is_rectified:
            reason = reason or f": {UNCALIBRATED}, or choose the topic of rectified images, as P is"
            continue
        found.append(message)
    if not found:
        raise CalibrationError(f"no message can be used{reason}")
    return found


def _usual(messages: Sequence[CalibrationMessage]) -> CalibrationMessage:
    """The first one with the values of most, of those with the size of most."""
    size = Counter(map(_size, messages)).most_common(1)[0][0]
    fitting = [message for message in messages if _size(message) == size]
    values = Counter(map(_values, fitting)).most_common(1)[0][0]
    return next(message for message in fitting if _values(message) == values)


def _size(message: CalibrationMessage) -> ImageSize:
    return message.camera.width, message.camera.height


def _values(message: CalibrationMessage) -> tuple[object, ...]:
    return message.camera, message.projection.tobytes()


def _warn_of_changes(
    topic: Topic, usual: CalibrationMessage, messages: Sequence[CalibrationMessage]
) -> None:
    """Warn of calibrations that change; with the focal length, the path is doubted."""
    changed = [message for message in messages if _values(message) != _values(usual)]
    if not changed:
        return
    camera = usual.camera
    same = [m.camera.fx for m in changed if _size(m) == _size(usual)]
    largest = max((fx / camera.fx - 1.0 for fx in same), key=abs, default=0.0)
    _log.warning(
        "%s: %d of %d calibrations of the log differ from that which is used (%dx%d, fx %g)%s",
        topic.name,
        len(changed),
        len(messages),
        camera.width,
        camera.height,
        camera.fx,
        f", in the focal length by up to {largest:+.1%}: zoom?" if largest else "",
        extra=warning_kind("calibration") if abs(largest) > _MIN_ZOOM else None,
    )
