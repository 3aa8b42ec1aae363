"""Wheel odometry, read from logs and tables: the way along the path, and dead reckoning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vo.base.errors import SourceError, VoError
from vo.base.geometry.transforms import inverse
from vo.base.types import Bools, Floats, Ints
from vo.recordings.formats.messages import PoseMessage, ReadMessage, TransformsMessage, TwistMessage
from vo.recordings.formats.positions import read_speed_csv
from vo.recordings.formats.trajectory import has_stamps, read_trajectory
from vo.recordings.sources.logs.choice import choose_topics
from vo.recordings.sources.logs.images import sorted_by_stamp
from vo.recordings.sources.logs.log import Log, Topic
from vo.recordings.sources.logs.opening import ChosenLog
from vo.recordings.sources.logs.poses import named_like_truth
from vo.runs.scaling.positions import located, log_of

_ODOMETRY = ("nav_msgs/msg/Odometry", "nav_msgs/Odometry")
_MAX_SPEED = 60.0  # m/s; a longer way between two poses is one of an odometry that was reset
_MAX_GAP_S = 0.5  # between samples, or a few of their usual intervals
_MAX_INTERVALS = 5.0
_MOVES_M = 1e-6
_MIN_SAMPLES = 10


@dataclass(frozen=True, eq=False)
class WheelOdometry:
    """Samples of wheel odometry in time order.

    Attributes:
        name: of the file or topic, for messages.
        stamps_ns: (N,) increasing.
        way_m: (N,) forward since the first sample, negative backwards.
        heading_rad: (N,) to the left since the first sample; None if it is unknown.
        xy_m: (N, 2) by dead reckoning; None without headings.
        parts: (N,) number of the part without gaps.
        cam0_from_base: (4, 4) of the frame whose motion it is, None if it is unknown.
    """

    name: str
    stamps_ns: Ints
    way_m: Floats
    heading_rad: Floats | None
    xy_m: Floats | None
    parts: Ints
    cam0_from_base: Floats | None = None

    def at(self, stamps_ns: Ints) -> tuple[Floats, Ints]:
        """(M, 4) way, heading and x, y at times; (M,) their parts, below 0 where unknown."""
        count = len(self.stamps_ns)
        before = np.searchsorted(self.stamps_ns, stamps_ns, side="right") - 1
        inside = (before >= 0) & (stamps_ns <= self.stamps_ns[-1])
        before = np.clip(before, 0, count - 2)
        same = self.parts[before] == self.parts[before + 1]
        since = self.stamps_ns[0]
        times, known = 1e-9 * (stamps_ns - since), 1e-9 * (self.stamps_ns - since)
        unknown = np.zeros(count)
        heading = unknown if self.heading_rad is None else self.heading_rad
        x, y = (unknown, unknown) if self.xy_m is None else self.xy_m.T
        values = np.column_stack(
            [np.interp(times, known, column) for column in (self.way_m, heading, x, y)]
        )
        return values, np.where(inside & same, self.parts[before], -1)


def read_wheel(given: str, recording: str | None, topics: Sequence[str] = ()) -> WheelOdometry:
    """Read wheel odometry.

    Args:
        given: a log or `LOG:/TOPIC` (Odometry, TwistStamped, TwistWithCovarianceStamped, or poses),
            `auto` for the recording itself, a CSV with `speed` and perhaps `yaw_rate`, or a
            trajectory of the base.
        recording: path of the recording, None if it has none.
        topics: options of the recording, which choose its cameras.

    Raises:
        SourceError: it is missing, damaged, has several topics, or too few samples.
    """
    path, wanted = located(given, recording, "wheel")
    log = log_of(path)
    if log is not None:
        return _from_log(log, wanted, topics)
    if path.is_dir():
        raise SourceError(f"{path} has no wheel odometry; give a log or a table of speeds")
    speeds = read_speed_csv(path)
    if speeds is not None:
        stamps_ns, values = _in_order(*speeds)
        return _of_twists(str(path), stamps_ns, values[:, 0], values[:, 1:].T)
    if not has_stamps(path):
        raise SourceError(
            f"{path} is no wheel odometry: give a CSV with `stamp` and `speed` in its first line, "
            "or poses with stamps"
        )
    found = read_trajectory(path)
    return _of_poses(str(path), found.stamps_ns, found.world_from_cam)


def _in_order(stamps_ns: Ints, values: Floats) -> tuple[Ints, Floats]:
    known = np.isfinite(values).all(axis=1)
    unique, rows = np.unique(stamps_ns[known], return_index=True)
    return unique, values[known][rows]


def _from_log(log: Log, wanted: str | None, topics: Sequence[str]) -> WheelOdometry:
    topic = _choose(log, wanted)
    name = f"{topic.name} of {log.path}"
    entries = log.entries([topic.name])[topic.name]
    found: dict[int, PoseMessage | TwistMessage] = {}
    for stamp_ns, row in sorted_by_stamp(log, topic, entries):
        message = _decoded(log, topic, entries[row])
        if isinstance(message, PoseMessage | TwistMessage):
            found.setdefault(stamp_ns, message)
    stamps_ns, messages = np.array(list(found), np.int64), list(found.values())
    poses = np.array([each.pose for each in messages if isinstance(each, PoseMessage)])
    twists = np.array([each.twist for each in messages if each.twist is not None])
    frame = next((_frame_of(each) for each in messages), "")
    moves = len(poses) > 0 and np.ptp(poses[:, :3, 3], axis=0).max() > _MOVES_M
    if len(poses) and (moves or len(twists) < len(poses)):
        wheel = _of_poses(name, stamps_ns, poses)
    else:
        wheel = _of_twists(name, stamps_ns, *_forward_and_yaw(name, twists))
    return replace(wheel, cam0_from_base=_cam0_from(log, frame, topics))


def _decoded(log: Log, topic: Topic, entry: object) -> ReadMessage | None:
    try:
        return topic.codec.decode(log.read(entry))  # type: ignore[arg-type]
    except VoError:
        return None


def _frame_of(message: PoseMessage | TwistMessage) -> str:
    return message.child if isinstance(message, PoseMessage) else message.frame


def _cam0_from(log: Log, frame: str, topics: Sequence[str]) -> Floats | None:
    """The base in the frame of the left camera, by fixed transforms of the same log."""
    if not frame or not any(issubclass(t.codec.kind, TransformsMessage) for t in log.topics):
        return None
    try:
        return ChosenLog(log, choose_topics(log.topics, topics, "auto")).cam0_from(frame)
    except VoError:  # a log without images
        return None


def _choose(log: Log, wanted: str | None) -> Topic:
    """The named topic, or the only one that can be meant: Odometry before twists before poses."""
    kinds = (PoseMessage, TwistMessage)
    topics = [topic for topic in log.topics if issubclass(topic.codec.kind, kinds)]
    listed = ", ".join(topic.name for topic in topics) or "none"
    if wanted is not None:
        named = [topic for topic in topics if topic.name == wanted]
        if named:
            return named[0]
        raise SourceError(f"{log.path} has no wheel odometry on {wanted}; it has {listed}")
    others = [topic for topic in topics if not named_like_truth(topic.name)]
    odometry = [topic for topic in others if topic.schema in _ODOMETRY]
    twists = [topic for topic in others if issubclass(topic.codec.kind, TwistMessage)]
    for group in (odometry, twists):
        if len(group) == 1:
            return group[0]
        if group:
            names = ", ".join(topic.name for topic in group)
            raise SourceError(
                f"{log.path} may have wheel odometry on {names}; choose one: "
                f"`wheel={log.path}:{group[0].name}`"
            )
    raise SourceError(
        f"{log.path} has no wheel odometry (Odometry, TwistStamped, TwistWithCovarianceStamped); "
        f"topics with poses: {listed}"
    )


def _of_poses(name: str, stamps_ns: Ints, poses: Floats) -> WheelOdometry:
    """Of poses of the base (x forward, z up), or of a camera (z forward, y down)."""
    _check_count(name, len(stamps_ns))
    motions = inverse(poses[:-1]) @ poses[1:]
    way = np.linalg.norm(motions[:, :3, 3], axis=1)
    is_reset = way > _MAX_SPEED * 1e-9 * np.diff(stamps_ns)
    is_camera = np.abs(motions[~is_reset, 2, 3]).sum() > 0.5 * way[~is_reset].sum()
    yaw = np.arctan2(motions[:, 1, 0], motions[:, 0, 0])
    ahead, left = motions[:, 0, 3], motions[:, 1, 3]
    if is_camera:
        yaw = np.arctan2(motions[:, 2, 0], motions[:, 0, 0])
        ahead, left = motions[:, 2, 3], -motions[:, 0, 3]
    # In the direction half-way between both poses; the way is that of an arc.
    cosine, sine = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    forward = (cosine * ahead + sine * left) / np.sinc(0.5 * yaw / np.pi)
    sideways = (cosine * left - sine * ahead) / np.sinc(0.5 * yaw / np.pi)
    return _dead_reckoned(name, stamps_ns, np.column_stack([forward, sideways]), yaw, is_reset)


def _forward_and_yaw(name: str, twists: Floats) -> tuple[Floats, Floats]:
    _check_count(name, len(twists))
    return twists[:, 0], twists[:, 5:].T


def _of_twists(name: str, stamps_ns: Ints, speed: Floats, yaw_rate: Floats) -> WheelOdometry:
    """`yaw_rate`: (1, N), or (0, N) if it is unknown."""
    _check_count(name, len(stamps_ns))
    elapsed = 1e-9 * np.diff(stamps_ns)
    way = 0.5 * (speed[1:] + speed[:-1]) * elapsed
    steps = np.column_stack([way, np.zeros_like(way)])
    yaw = None if not len(yaw_rate) else 0.5 * (yaw_rate[0, 1:] + yaw_rate[0, :-1]) * elapsed
    return _dead_reckoned(name, stamps_ns, steps, yaw, np.zeros(len(way), bool))


def _dead_reckoned(
    name: str, stamps_ns: Ints, steps: Floats, yaw: Floats | None, is_reset: Bools
) -> WheelOdometry:
    """`steps`: (N - 1, 2) ways of arcs, forward and to the left."""
    elapsed = 1e-9 * np.diff(stamps_ns)
    longest = max(_MAX_GAP_S, _MAX_INTERVALS * float(np.median(elapsed)))
    is_gap = is_reset | (elapsed > longest)
    steps = np.where(is_gap[:, None], 0.0, steps)
    way_m = np.r_[0.0, np.cumsum(steps[:, 0])]
    parts = np.r_[0, np.cumsum(is_gap)]
    if yaw is None:
        return WheelOdometry(name, stamps_ns, way_m, None, None, parts)
    yaw = np.where(is_gap, 0.0, yaw)
    heading = np.r_[0.0, np.cumsum(yaw)]
    middle = heading[:-1] + 0.5 * yaw
    chord = np.sinc(0.5 * yaw / np.pi)[:, None]
    x = chord[:, 0] * (np.cos(middle) * steps[:, 0] - np.sin(middle) * steps[:, 1])
    y = chord[:, 0] * (np.sin(middle) * steps[:, 0] + np.cos(middle) * steps[:, 1])
    xy_m = np.vstack([np.zeros(2), np.cumsum(np.column_stack([x, y]), axis=0)])
    return WheelOdometry(name, stamps_ns, way_m, heading, xy_m, parts)


def _check_count(name: str, count: int) -> None:
    if count < _MIN_SAMPLES:
        raise SourceError(f"{name} has {count} samples of wheel odometry; give at least ten")
