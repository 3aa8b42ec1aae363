"""Ground-truth poses in a log."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence

import numpy as np

from vo.errors import SourceError
from vo.formats.calibration import Calibration
from vo.formats.messages import PoseMessage
from vo.sources.listing import MAX_STAMP_NS
from vo.sources.logs.frame_tree import FrameTree
from vo.sources.logs.log import Entry, Log, Topic
from vo.types import Floats, Trajectory

_log = logging.getLogger(__name__)

_NAMED_LIKE_TRUTH = re.compile(
    r"truth|(?<![a-z])gt(?![a-z])|mocap|vicon|optitrack|qualisys|leica", re.IGNORECASE
)


def find_truth_topic(topics: Sequence[Topic], named: str | None) -> Topic | None:
    """The topic given by the user, or else the first pose topic named like ground truth."""
    poses = [topic for topic in topics if issubclass(topic.codec.kind, PoseMessage)]
    if named is not None:
        return next((t for t in poses if t.name.strip("/") == named.strip("/")), None)
    return next((topic for topic in poses if _NAMED_LIKE_TRUTH.search(topic.name)), None)


def read_truth(
    log: Log,
    topic: Topic,
    entries: Sequence[Entry],
    cam0: str,
    frames: FrameTree,
    calibration: Calibration,
) -> Trajectory:
    """Poses of cam0 in the world.

    Poses without a child frame are assumed to be those of the topmost frame that is fixed to cam0,
    the base of the robot.

    Args:
        log: the log.
        topic: topic of the poses.
        entries: its messages.
        cam0: frame of the left camera.
        frames: the fixed transforms.
        calibration: may contain the pose of cam0 on the body.

    Raises:
        SourceError: the pose of the camera on the body is unknown.
    """
    poses: dict[int, Floats] = {}
    child = ""
    unreadable = 0
    for entry in entries:
        try:
            message = topic.codec.decode(log.read(entry))
        except SourceError:
            unreadable += 1
            continue
        stamp_ns = message.stamp_ns or entry.log_ns
        if isinstance(message, PoseMessage) and abs(stamp_ns) <= MAX_STAMP_NS:
            poses.setdefault(stamp_ns, message.pose)
            child = child or message.child
    if unreadable:
        _log.warning("%s: %d of %d poses cannot be read", topic.name, unreadable, len(entries))
    body = child or frames.root(cam0)
    body_from_cam0 = calibration.body_from_cam0
    # Poses without a child frame need not be those of a camera that no frame is fixed to.
    if body_from_cam0 is None and (child or body != cam0):
        body_from_cam0 = frames.between(body, cam0)
    if body_from_cam0 is None:
        raise SourceError(
            f"{topic.name} has poses of {f'frame {child!r}' if child else 'the body'}, but no "
            f"transforms connect it to the camera (frame '{cam0}')"
        )
    stamps_ns = np.array(sorted(poses), dtype=np.int64)
    world_from_body = np.array([poses[int(stamp)] for stamp in stamps_ns]).reshape(-1, 4, 4)
    return Trajectory(stamps_ns, world_from_body @ body_from_cam0)
