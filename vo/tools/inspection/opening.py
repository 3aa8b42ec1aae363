"""Opening of recordings as far as possible, even if `vo run` would refuse them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from vo.base.errors import NoCalibration, SourceError, VoError
from vo.base.types import Camera, Ints, Mode, Rig, Trajectory
from vo.recordings.formats.calibration import Calibration, ImageSize
from vo.recordings.formats.warning_kinds import LoggedWarning, collected_warnings
from vo.recordings.sources.assembly import RecordingContents, assemble
from vo.recordings.sources.images import StoredImage
from vo.recordings.sources.imu import Imu
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.logs.choice import IMAGE_KINDS, choose_topics
from vo.recordings.sources.logs.images import list_images
from vo.recordings.sources.logs.imu import imu_topics, log_imus
from vo.recordings.sources.logs.log import Log, Topic, UnreadTopic
from vo.recordings.sources.logs.opening import open_log
from vo.recordings.sources.logs.poses import choose_pose_source, list_pose_sources, read_poses
from vo.recordings.sources.pairing import pair_by_stamp, shifted
from vo.recordings.sources.registry import FORMATS, choose_format, gather, open_container
from vo.recordings.sources.sequence import ImageSequence as SourceSequence


@dataclass(frozen=True, eq=False)
class ImageSequence:
    """Images of a camera by increasing stamp."""

    name: str  # `cam0`, `cam1`, … or a topic
    shots: Sequence[Shot]
    repeated_stamps: int = 0  # number of images left out because of a repeated stamp


@dataclass(frozen=True, eq=False)
class OpenedRecording:
    """A recording as far as it could be opened."""

    path: Path
    format: str
    cameras: tuple[ImageSequence, ...] = ()  # those of the rig, or all candidates
    roles_known: bool = True  # whether these are those of the rig
    topics: tuple[Topic, ...] = ()
    unread: tuple[UnreadTopic, ...] = ()
    imus: tuple[Imu, ...] = ()
    source: SourceSequence | None = None  # the source as `vo run` opens it; None if it refuses
    # The calibration, even if `vo run` refuses for another reason; None if unknown
    rig: Rig | None = None
    calibration: str = ""  # file and format of the calibration; empty if it is not a file
    # Ground truth poses of cam0; of a log without images, its poses as logged
    truth: Trajectory | None = None
    pose_names: tuple[str, ...] = ()  # topics with poses of a log, and pairs of frames that move
    refusal: str = ""  # the error message of `vo run`; empty if there is none
    has_unknown_camera: bool = False  # whether `vo run` estimates it, instead of that refusal
    warnings: tuple[LoggedWarning, ...] = ()
    options: tuple[str, ...] = ()  # the options that chose how it is read, as words of a command
    close: Callable[[], None] = field(default=lambda: None)


def open_leniently(
    path: Path,
    *,
    format: str | None = None,
    calibration: Path | None = None,
    mode: Mode = "auto",
    topics: Sequence[str] = (),
    right_offset_ns: int | None = None,
) -> OpenedRecording:
    """Open a recording as far as possible; arguments as in `open_source`.

    Raises:
        SourceError: the path does not exist, or its format is unknown.
    """
    with collected_warnings() as warnings:
        name = choose_format(path, format)
        if FORMATS[name].has_topics:
            found = _open_log(path, name, calibration, mode, topics, right_offset_ns)
        else:
            found = _open_files(path, name, calibration, mode, right_offset_ns)
    offset_ns = (right_offset_ns or 0) if found.source is None else found.source.right_offset_ns
    cameras = found.cameras
    if found.roles_known and len(cameras) == 2 and offset_ns:
        cameras = (cameras[0], replace(cameras[1], shots=shifted(cameras[1].shots, offset_ns)))
    options = _options(format, calibration, mode, topics)
    if right_offset_ns is not None:
        options += ("--right-offset", f"{1e-6 * right_offset_ns:g}")
    unique = tuple(dict.fromkeys(warnings))
    return replace(found, cameras=cameras, warnings=unique, options=options)


def _options(
    format: str | None, calibration: Path | None, mode: Mode, topics: Sequence[str]
) -> tuple[str, ...]:
    """The arguments of `open_source` that differ from its defaults, as words of a command."""
    words = [word for topic in topics for word in ("--topic", topic)]
    if mode != "auto":
        words += ["--mode", mode]
    if format is not None:
        words += ["--format", format]
    if calibration is not None:
        words += ["--calibration", str(calibration)]
    return tuple(words)


def _with_record(listed: RecordingContents, loaded: list[Calibration]) -> RecordingContents:
    """The same contents; a calibration is appended to the list when it is read."""

    def calibrate(size: ImageSize) -> Calibration:
        loaded.append(listed.calibrate(size))
        return loaded[-1]

    return replace(listed, calibrate=calibrate)


def _origin(loaded: Sequence[Calibration]) -> str:
    if not loaded or loaded[0].file is None:
        return ""
    return f"{loaded[0].file} ({loaded[0].kind})"


def _open_files(
    path: Path, name: str, calibration: Path | None, mode: Mode, right_offset_ns: int | None
) -> OpenedRecording:
    try:
        listed = gather(path, name, calibration, mode)
        loaded: list[Calibration] = []
        listed = _with_record(replace(listed, right_offset_ns=right_offset_ns), loaded)
    except VoError as error:
        return OpenedRecording(path, name, refusal=str(error))
    cameras = [ImageSequence("cam0", listed.left)]
    if listed.right:
        cameras.append(ImageSequence("cam1", listed.right))
    found = OpenedRecording(path, name, tuple(cameras), close=listed.close or (lambda: None))
    try:
        source = assemble(listed, mode)
    except VoError as error:
        return replace(
            found,
            rig=_rig_alone(listed),
            calibration=_origin(loaded),
            truth=_truth_alone(listed),
            imus=tuple(listed.find_imus(None)),
            refusal=str(error),
            has_unknown_camera=isinstance(error, NoCalibration),
        )
    used = zip(listed.further, source.rig.further, strict=False)
    cameras += [ImageSequence(f"cam{n}", s) for n, (s, _) in enumerate(used, start=2) if s]
    return replace(
        found,
        cameras=tuple(cameras),
        source=source,
        rig=source.rig,
        calibration=_origin(loaded),
        truth=source.ground_truth,
        imus=source.imus,
    )


def _rig_alone(listed: RecordingContents) -> Rig | None:
    """The calibration, if the recording is refused for another reason; None if unreadable."""
    try:
        height, width = listed.left[0].image.read().shape
        return listed.calibrate((width, height)).rig
    except VoError:
        return None


def _truth_alone(listed: RecordingContents) -> Trajectory | None:
    """The ground truth, if it is that of cam0 and needs no calibration; else None."""
    try:
        return listed.read_truth(Calibration(Rig(Camera(1, 1, 1.0, 1.0, 0.0, 0.0))))
    except (VoError, OSError, ValueError):
        return None


def _open_log(
    path: Path,
    name: str,
    calibration: Path | None,
    mode: Mode,
    requested_topics: Sequence[str],
    right_offset_ns: int | None,
) -> OpenedRecording:
    log = open_container(path, name)
    found = OpenedRecording(
        path,
        name,
        topics=_with_own_spans(log),
        unread=tuple(log.unread),
        imus=tuple(log_imus(log, imu_topics(log.topics), lambda _: None)),
        pose_names=tuple(each.name for each in list_pose_sources(log)),
    )
    try:
        may_be_rig = calibration is None
        choice = choose_topics(log.topics, requested_topics, mode, may_be_rig=may_be_rig)
    except SourceError as error:
        return _undecided(found, log, error)
    chosen = {"cam0": choice.left}
    if choice.right is not None and mode != "mono":
        chosen["cam1"] = choice.right
    if mode == "auto":
        chosen |= {f"cam{n}": topic for n, topic in enumerate(choice.further, start=2)}
    asked, found = found, replace(found, cameras=_cameras(log, chosen))
    try:
        source = open_log(log, name, calibration, mode, requested_topics, right_offset_ns)
        if choice.further:
            found = replace(found, cameras=found.cameras[: len(source.rig.cameras)])
    except VoError as error:
        if choice.doubt:
            return _undecided(asked, log, error)
        is_unknown = isinstance(error, NoCalibration)
        return replace(found, refusal=str(error), has_unknown_camera=is_unknown)
    return replace(
        found,
        source=source,
        rig=source.rig,
        calibration="" if calibration is None else str(calibration),
        truth=source.ground_truth,
        imus=source.imus,
    )


def _undecided(found: OpenedRecording, log: Log, error: VoError) -> OpenedRecording:
    """A log of which no one knows the cameras: all its images."""
    images = [topic for topic in log.topics if issubclass(topic.codec.kind, IMAGE_KINDS)]
    return replace(
        found,
        cameras=_cameras(log, {topic.name: topic for topic in images}),
        roles_known=False,
        truth=None if images else _poses_alone(log),
        refusal=str(error),
    )


def _poses_alone(log: Log) -> Trajectory | None:
    """The poses that `vo eval` takes as ground truth of a log without images; None if unclear."""
    try:
        return read_poses(log, choose_pose_source(log, "truth", None)).trajectory
    except SourceError:
        return None


def _with_own_spans(log: Log) -> tuple[Topic, ...]:
    """Topics with exact rates: the summary of an MCAP file contains only the span of the file."""
    entries = log.entries([topic.name for topic in log.topics])
    spans_ns = {
        name: max(e.log_ns for e in listed) - min(e.log_ns for e in listed) if listed else 0
        for name, listed in entries.items()
    }
    return tuple(replace(topic, span_ns=spans_ns[topic.name]) for topic in log.topics)


def _cameras(log: Log, topics: dict[str, Topic]) -> tuple[ImageSequence, ...]:
    entries = log.entries([topic.name for topic in topics.values()])
    cameras = []
    for name, topic in topics.items():
        try:
            shots = list_images(log, topic, entries[topic.name])
        except SourceError:
            continue
        cameras.append(ImageSequence(name, shots, len(entries[topic.name]) - len(shots)))
    return tuple(cameras)


def right_stamps(left: Sequence[Shot], right: Sequence[Shot]) -> Ints:
    """(N,) stamp of the right image paired with each left image; -1 without one."""
    stamp_of: dict[int, int] = {id(shot.image): shot.stamp_ns for shot in right}
    partners: list[StoredImage | None] = pair_by_stamp(left, right)
    return np.array([-1 if p is None else stamp_of[id(p)] for p in partners], dtype=np.int64)
