"""Cameras of a log, from its calibration messages and its frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vo.base.errors import CalibrationError, SourceError, VoError
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Camera, Floats
from vo.recordings.formats.calibration.checks import check_baseline
from vo.recordings.formats.messages import CalibrationMessage
from vo.recordings.sources.logs.choice import base_name
from vo.recordings.sources.logs.frame_tree import FrameTree
from vo.recordings.sources.logs.log import Entry, Log, Topic

_MAX_MESSAGES = 100
_MIN_COSINE = 0.5  # of the angle between optical axes


@dataclass(frozen=True, eq=False)
class LogCamera:
    """A camera of a log.

    Attributes:
        frame: its coordinate frame, that of its first image.
        calibration: its first calibration message.
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
        return replace(
            camera,
            fx=float(p[0, 0]),
            fy=float(p[1, 1]),
            cx=float(p[0, 2]),
            cy=float(p[1, 2]),
            distortion_model="none",
            distortion=(),
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
    by_name = same if len(same) == 1 else []
    reason = ""
    for topic in [*by_name, *(t for t in calibrations if t not in by_name)]:
        try:
            found = _first_message(log, topic, entries[topic.name])
        except VoError as error:
            if topic in by_name:
                raise CalibrationError(f"{topic.name}: {error}") from error
            reason = reason or f"; {topic.name}: {error}"
            continue
        if topic in by_name or (frame and found.frame == frame):
            return LogCamera(image.name, frame or found.frame, found, "rect" in last)
    others = ", ".join(topic.name for topic in calibrations) or "none"
    raise CalibrationError(
        f"no calibration for {image.name} in the log (topics with calibrations: {others}{reason}); "
        "give a file with `calibration=FILE` (format: docs/calibration.md)"
    )


def cam1_from_cam0(left: LogCamera, right: LogCamera, frames: FrameTree) -> Floats:
    """Extrinsics of the right camera, from the frame tree or from the rectification."""
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
            f"'{left.frame}' to '{right.frame}', and the last column of the right camera's P is 0; "
            "give a file with `calibration=FILE`, or use `mode=mono`"
        )
    cosine = max(float(found[2, 2]), -1.0)
    if cosine < _MIN_COSINE:
        raise CalibrationError(
            f"the optical axes of {left.topic} and {right.topic} differ by "
            f"{np.degrees(np.arccos(cosine)):.0f} degrees, too much for a stereo pair; choose "
            "other topics, or one with `topics`"
        )
    check_baseline(f"{left.topic} and {right.topic}", found)
    return found


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


def _offset(camera: LogCamera) -> Floats:
    p = camera.calibration.projection
    if abs(np.linalg.det(p[:, :3])) < 1e-9:
        raise CalibrationError(f"the projection P of {camera.topic} cannot be inverted")
    return np.asarray(np.linalg.solve(p[:, :3], p[:, 3]))


def _first_message(log: Log, topic: Topic, entries: Sequence[Entry]) -> CalibrationMessage:
    """The first readable message."""
    reason = ""
    for entry in entries[:_MAX_MESSAGES]:
        try:
            message = topic.codec.decode(log.read(entry))
        except SourceError as error:
            reason = reason or f": {error}"
            continue
        if isinstance(message, CalibrationMessage):
            return message
    raise SourceError(f"no message can be read{reason}")
