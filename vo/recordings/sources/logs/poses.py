"""Poses in a log, whether or not it has images: pose topics, paths, and moving frames of tf."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vo.base.errors import SourceError, VoError
from vo.base.geometry.transforms import interpolate, inverse
from vo.base.printable import counted
from vo.base.types import Floats, Trajectory
from vo.recordings.formats.calibration import Calibration
from vo.recordings.formats.messages import PathMessage, PoseMessage, TransformsMessage
from vo.recordings.formats.stamp_units import MAX_STAMP_NS
from vo.recordings.sources.logs.frame_tree import FrameTree, chain, read_frame_tree
from vo.recordings.sources.logs.log import Entry, Log, Topic
from vo.recordings.sources.logs.stamps import message_stamps

_log = logging.getLogger(__name__)

POSE_KINDS = (PoseMessage, PathMessage)

_NAMED_LIKE_TRUTH = re.compile(
    r"truth|(?<![a-z])gt(?![a-z])|mocap|vicon|optitrack|qualisys|leica", re.IGNORECASE
)


class PoseSource(NamedTuple):
    """Where a log has poses: a topic, or a pair of frames on a topic of transforms."""

    topic: Topic
    frames: tuple[str, str] | None = None

    @property
    def name(self) -> str:
        """The topic, or `TOPIC:PARENT:CHILD`, as `--topic` accepts it."""
        return ":".join([self.topic.name, *(self.frames or ())])


@dataclass(frozen=True, eq=False)
class LoggedPoses:
    """Poses as logged, and the frame that they are poses of; empty if the messages name none."""

    trajectory: Trajectory
    child: str


def named_like_truth(name: str) -> bool:
    """Whether the name of a topic or frame is typical of ground truth."""
    return bool(_NAMED_LIKE_TRUTH.search(name))


def list_pose_sources(log: Log) -> list[PoseSource]:
    """All topics with poses, and all pairs of frames that move relative to each other."""
    found = [PoseSource(topic) for topic in log.topics if issubclass(topic.codec.kind, POSE_KINDS)]
    transforms = _transform_topics(log)
    entries = log.entries([topic.name for topic in transforms])
    for topic in transforms:
        tree = read_frame_tree(log, [(topic, entries[topic.name])])
        found += [PoseSource(topic, pair) for pair in tree.moving]
    return found


def choose_pose_source(log: Log, role: str, named: str | None) -> PoseSource:
    """The poses named by the user, or else the only ones that can be meant.

    Without a name, truth is the only topic named like ground truth, and an estimate the only other
    one.

    `named`: `TOPIC`, or `TOPIC:PARENT:CHILD` for frames of tf.
    """
    sources = list_pose_sources(log)
    if named is not None:
        return _named_source(log, sources, role, named)
    if not sources:
        raise SourceError(
            f"{log.path} has no poses: no PoseStamped, PoseWithCovarianceStamped, Odometry, "
            "TransformStamped, Path or moving frames of tf"
        )
    alike = [each for each in sources if named_like_truth(each.name)]
    others = [each for each in sources if each not in alike]
    for candidates in (alike, others) if role == "truth" else (others, alike):
        if len(candidates) == 1:
            return candidates[0]
        if candidates:
            break
    raise SourceError(_ambiguity(log, sources, role))


def read_poses(log: Log, source: PoseSource) -> LoggedPoses:
    """Read poses as they were logged."""
    if source.frames is not None:
        return LoggedPoses(_between_frames(log, *source.frames), source.frames[1])
    topic = source.topic
    return poses_on_topic(log, topic, log.entries([topic.name])[topic.name])


def poses_on_topic(log: Log, topic: Topic, entries: Sequence[Entry]) -> LoggedPoses:
    """Read the poses of a topic; of paths, which are published again and again, the latest."""
    poses: dict[int, Floats] = {}
    child, reason, unreadable = "", "", 0
    is_path = issubclass(topic.codec.kind, PathMessage)
    stamps = [0] * len(entries) if is_path else message_stamps(log, topic, entries)
    in_order = list(zip(entries, stamps, strict=True))
    for entry, stamp in reversed(in_order) if is_path else in_order:
        try:
            message = topic.codec.decode(log.read(entry))
        except SourceError as error:
            reason = reason or f": {error}"
            unreadable += 1
            continue
        known = len(poses)
        for pose in message.poses if isinstance(message, PathMessage) else (message,):
            stamp_ns = pose.stamp_ns if is_path else stamp
            if isinstance(pose, PoseMessage) and 0 <= stamp_ns <= MAX_STAMP_NS:
                poses.setdefault(stamp_ns, pose.pose)
                child = child or pose.child
        if is_path and len(poses) == known:
            break  # all earlier ones are its beginnings
    if unreadable:
        _log.warning("%s: %d of %d messages cannot be read", topic.name, unreadable, len(entries))
    if not poses:
        raise SourceError(f"{log.path}: no pose on {topic.name} can be read{reason}")
    return LoggedPoses(_trajectory(poses), child)


def _named_source(log: Log, sources: Sequence[PoseSource], role: str, named: str) -> PoseSource:
    name, *frames = named.split(":")
    matching = [each for each in sources if each.topic.name.strip("/") == name.strip("/")]
    transforms = [t for t in _transform_topics(log) if t.name.strip("/") == name.strip("/")]
    if len(frames) == 2 and transforms:
        return PoseSource(transforms[0], (frames[0].lstrip("/"), frames[1].lstrip("/")))
    if not frames and len(matching) == 1:
        return matching[0]
    if frames or not matching:
        listed = "\n".join(f"  {each.name}" for each in sources) or "  none"
        raise SourceError(f"{log.path} has no poses '{named}'; these can be chosen\n{listed}")
    raise SourceError(_ambiguity(log, matching, role))


def _ambiguity(log: Log, sources: Sequence[PoseSource], role: str) -> str:
    width = max(len(each.name) for each in sources)
    listed = "\n".join(
        f"  {each.name:<{width}}  {each.topic.schema}  {counted(each.topic.count, 'message')}"
        for each in sources
    )
    return (
        f"{log.path} has poses in {len(sources)} places; choose the {role} with `topics` "
        f"{role}={sources[0].name}\n{listed}"
    )


def _transform_topics(log: Log) -> list[Topic]:
    return [topic for topic in log.topics if issubclass(topic.codec.kind, TransformsMessage)]


def _between_frames(log: Log, parent: str, child: str) -> Trajectory:
    """Poses of a frame in another one, at the stamps of the transform with the most messages."""
    edges = _edges(log)
    steps = chain(edges, parent, child)
    if not steps:
        known = ", ".join(sorted({frame for pair in edges for frame in pair}))
        raise SourceError(
            f"{log.path}: no transforms connect frame '{parent}' to '{child}'; frames: {known}"
        )
    longest = max((edges[_stored(edges, *step)] for step in steps), key=len)
    stamps_ns = longest.stamps_ns
    for step in steps:  # no extrapolation of other moving transforms
        own = edges[_stored(edges, *step)].stamps_ns
        if len(own) > 1:
            stamps_ns = stamps_ns[(stamps_ns >= own[0]) & (stamps_ns <= own[-1])]
    poses = np.tile(np.eye(4), (len(stamps_ns), 1, 1))
    for a, b in steps:
        stored = _stored(edges, a, b)
        each = np.array([_pose_at(edges[stored], int(stamp)) for stamp in stamps_ns])
        if len(each):
            poses = poses @ (each if stored == (a, b) else np.array([inverse(p) for p in each]))
    if not len(poses):
        raise SourceError(f"{log.path}: transforms from '{parent}' to '{child}' never overlap")
    return Trajectory(stamps_ns, poses)


def _edges(log: Log) -> dict[tuple[str, str], Trajectory]:
    """All transforms of the log by parent and child."""
    found: dict[tuple[str, str], dict[int, Floats]] = {}
    topics = _transform_topics(log)
    entries = log.entries([topic.name for topic in topics])
    for topic in topics:
        for entry, message in _messages(log, topic, entries[topic.name]):
            for each in message.transforms:
                stamp_ns = each.stamp_ns or entry.log_ns
                if 0 <= stamp_ns <= MAX_STAMP_NS:
                    poses = found.setdefault((each.parent, each.child), {})
                    poses.setdefault(stamp_ns, each.parent_from_child)
    return {pair: _trajectory(poses) for pair, poses in found.items()}


def _messages(
    log: Log, topic: Topic, entries: Iterable[Entry]
) -> Iterator[tuple[Entry, TransformsMessage]]:
    for entry in entries:
        try:
            message = topic.codec.decode(log.read(entry))
        except VoError:
            continue
        if isinstance(message, TransformsMessage):
            yield entry, message


def _stored(edges: dict[tuple[str, str], Trajectory], a: str, b: str) -> tuple[str, str]:
    return (a, b) if (a, b) in edges else (b, a)


def _pose_at(poses: Trajectory, stamp_ns: int) -> Floats:
    """The pose at a time between the first and the last; a single pose is constant."""
    stamps_ns = poses.stamps_ns
    after = int(np.searchsorted(stamps_ns, stamp_ns).clip(0, len(stamps_ns) - 1))
    if after == 0 or stamps_ns[after] == stamp_ns:
        return np.asarray(poses.world_from_cam[after])
    before = after - 1
    fraction = float(stamp_ns - stamps_ns[before]) / float(stamps_ns[after] - stamps_ns[before])
    return interpolate(poses.world_from_cam[before], poses.world_from_cam[after], fraction)


def _trajectory(poses: dict[int, Floats]) -> Trajectory:
    stamps_ns = np.array(sorted(poses), dtype=np.int64)
    return Trajectory(
        stamps_ns, np.array([poses[int(stamp)] for stamp in stamps_ns]).reshape(-1, 4, 4)
    )


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
