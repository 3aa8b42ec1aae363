"""The cameras of a log, from its calibration messages and its frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vo.errors import CalibrationError, SourceError, VoError
from vo.formats.calibration.checks import check_baseline
from vo.formats.messages import CalibrationMessage
from vo.geometry.transforms import inverse, make_transform
from vo.sources.logs.choice import base_name
from vo.sources.logs.frames import FrameTree
from vo.sources.logs.log import Entry, Log, Topic
from vo.types import Camera, Floats

_MOST_TRIED = 100
_LEAST_COSINE = 0.5  # of the angle between optical axes


@dataclass(frozen=True, eq=False)
class LogCamera:
    """A camera of a log.

    Attributes:
        topic: of its images.
        frame: its name in the tree of frames; of its first image.
        calibration: the first message that says what it is.
        is_rectified: whether its images are, so that they have no distortion.
    """

    topic: str
    frame: str
    calibration: CalibrationMessage
    is_rectified: bool

    @property
    def camera(self) -> Camera:
        """The lens that its images were taken with."""
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
    """The calibration of the camera of some images: by name, or else by frame.

    Args:
        log: where all is.
        image: topic of the images.
        frame: of the images.
        calibrations: topics of calibrations.
        entries: their messages.

    Raises:
        CalibrationError: there is none, or it cannot be true.
    """
    space, _, last = base_name(image.name).rpartition("/")
    near = [t for t in calibrations if t.name.rpartition("/")[0] in (space, f"{space}/{last}")]
    beside = near if len(near) == 1 else []
    reason = ""
    for topic in [*beside, *(t for t in calibrations if t not in beside)]:
        try:
            found = _first(log, topic, entries[topic.name])
        except VoError as error:
            if topic in beside:
                raise CalibrationError(f"{topic.name}: {error}") from error
            reason = reason or f"; {topic.name}: {error}"
            continue
        if topic in beside or (frame and found.frame == frame):
            return LogCamera(image.name, frame or found.frame, found, "rect" in last)
    others = ", ".join(topic.name for topic in calibrations) or "none"
    raise CalibrationError(
        f"no calibration for {image.name} in the log (topics with calibrations: {others}{reason}); "
        "give a file with --calibration FILE (docs/calibration.md shows what it looks like)"
    )


def cam1_from_cam0(left: LogCamera, right: LogCamera, frames: FrameTree) -> Floats:
    """Where the right camera is: from the tree of frames, or from the rectification.

    Raises:
        CalibrationError: neither says it, or the cameras look apart.
    """
    by_projection = _from_projections(left, right)
    by_frames = None
    if left.frame and right.frame and left.frame != right.frame:
        by_frames = frames.between(right.frame, left.frame)
    # Frames are those of the cameras as they are; rectified ones are turned.
    first, second = by_frames, by_projection
    if left.is_rectified and right.is_rectified:
        first, second = second, first
    found = first if first is not None else second
    if found is None:
        raise CalibrationError(
            f"nothing says where {right.topic} is beside {left.topic}: no transforms lead from "
            f"frame '{left.frame}' to '{right.frame}', and the last column of the right "
            "camera's P is 0; give a file with --calibration FILE, or use --mode mono"
        )
    cosine = max(float(found[2, 2]), -1.0)
    if cosine < _LEAST_COSINE:
        raise CalibrationError(
            f"{left.topic} and {right.topic} look {np.degrees(np.arccos(cosine)):.0f} degrees "
            "apart and are no stereo pair; choose other topics, or one with --topic"
        )
    check_baseline(f"{left.topic} and {right.topic}", found)
    return found


def _from_projections(left: LogCamera, right: LogCamera) -> Floats | None:
    """From the last columns of the rectified projections P = K [I | t]."""
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


def _first(log: Log, topic: Topic, entries: Sequence[Entry]) -> CalibrationMessage:
    """The first message that can be read.

    Raises:
        CalibrationError: what it says cannot be true.
        SourceError: there is none.
    """
    reason = ""
    for entry in entries[:_MOST_TRIED]:
        try:
            message = topic.codec.decode(log.read(entry))
        except SourceError as error:
            reason = reason or f": {error}"
            continue
        if isinstance(message, CalibrationMessage):
            return message
    raise SourceError(f"no message can be read{reason}")
