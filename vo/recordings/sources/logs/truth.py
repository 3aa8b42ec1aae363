"""Ground-truth poses in a log."""

from __future__ import annotations

from collections.abc import Sequence

from vo.base.errors import SourceError
from vo.base.types import Trajectory
from vo.recordings.formats.calibration import Calibration
from vo.recordings.sources.logs.frame_tree import FrameTree
from vo.recordings.sources.logs.log import Entry, Log, Topic
from vo.recordings.sources.logs.poses import POSE_KINDS, named_like_truth, poses_on_topic


def find_truth_topic(topics: Sequence[Topic], named: str | None) -> Topic | None:
    """The topic given by the user, or else the first pose topic named like ground truth."""
    poses = [topic for topic in topics if issubclass(topic.codec.kind, POSE_KINDS)]
    if named is None:
        return next((topic for topic in poses if named_like_truth(topic.name)), None)
    found = next((t for t in poses if t.name.strip("/") == named.strip("/")), None)
    if found is None:
        others = ", ".join(topic.name for topic in poses) or "none"
        raise SourceError(f"`topics=truth={named}` has no poses; topics with poses: {others}")
    return found


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
    """
    logged = poses_on_topic(log, topic, entries)
    child = logged.child
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
    truth = logged.trajectory
    return Trajectory(truth.stamps_ns, truth.world_from_cam @ body_from_cam0)
