"""Opens a recording as far as that goes, also where a run would refuse."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from vo.errors import SourceError, VoError
from vo.formats.calibration import Calibration
from vo.sources.assembly import Gathered, assemble
from vo.sources.images import StoredImage
from vo.sources.imu import Imu
from vo.sources.listing import Shot
from vo.sources.logs.choice import IMAGE_KINDS, choose_topics
from vo.sources.logs.images import list_images
from vo.sources.logs.imu import imu_topics
from vo.sources.logs.imu_pairs import log_imus
from vo.sources.logs.log import Log, Topic, UnreadTopic
from vo.sources.logs.opening import open_log
from vo.sources.pairing import pair_by_stamp
from vo.sources.registry import FORMATS, choose_format, gather, open_container
from vo.sources.source import Source
from vo.types import Camera, Ints, Mode, Rig, Trajectory


@dataclass(frozen=True, eq=False)
class CameraShots:
    """The images of a camera, stamps increasing, and how many repeat a stamp."""

    name: str
    shots: Sequence[Shot]
    repeated_stamps: int = 0


@dataclass(frozen=True, eq=False)
class Material:
    """A recording as far as it could be opened.

    Attributes:
        path: as given.
        format: name in the registry.
        cameras: left and right, or all that come into question.
        is_decided: whether these are left and right.
        topics: of a log.
        unread: its other topics.
        imus: inertial sensors, the one to use first.
        source: as a run would open it; None where it would refuse.
        rig: the cameras, also where it would refuse for another reason; None where unknown.
        truth: poses of cam0.
        refusal: why a run would refuse; empty where it would not.
        warnings: what was said while it was opened.
        close: closes what images keep open.
    """

    path: Path
    format: str
    cameras: tuple[CameraShots, ...] = ()
    is_decided: bool = True
    topics: tuple[Topic, ...] = ()
    unread: tuple[UnreadTopic, ...] = ()
    imus: tuple[Imu, ...] = ()
    source: Source | None = None
    rig: Rig | None = None
    truth: Trajectory | None = None
    refusal: str = ""
    warnings: tuple[str, ...] = ()
    close: Callable[[], None] = field(default=lambda: None)


def look_into(
    path: Path,
    *,
    format: str | None = None,
    calibration: Path | None = None,
    mode: Mode = "auto",
    topics: Sequence[str] = (),
) -> Material:
    """Open a recording as far as that goes; arguments as in `open_source`.

    Raises:
        SourceError: there is nothing at the path, or of no known format.
    """
    with collected_warnings() as warnings:
        name = choose_format(path, format)
        if FORMATS[name].log:
            found = _log_at(path, name, calibration, mode, topics)
        else:
            found = _files_at(path, name, calibration, mode)
    return replace(found, warnings=tuple(dict.fromkeys(warnings)))


def _files_at(path: Path, name: str, calibration: Path | None, mode: Mode) -> Material:
    try:
        listed = gather(path, name, calibration, mode)
    except VoError as error:
        return Material(path, name, refusal=str(error))
    cameras = [CameraShots("cam0", listed.left)]
    if listed.right:
        cameras.append(CameraShots("cam1", listed.right))
    found = Material(path, name, tuple(cameras), close=listed.close or (lambda: None))
    try:
        source = assemble(listed, mode)
    except VoError as error:
        return replace(
            found,
            rig=_rig_alone(listed),
            truth=_truth_alone(listed),
            imus=tuple(listed.find_imus(None)),
            refusal=str(error),
        )
    return replace(
        found, source=source, rig=source.rig, truth=source.ground_truth, imus=source.imus
    )


def _rig_alone(listed: Gathered) -> Rig | None:
    """The calibration where something else is wrong with the recording."""
    try:
        height, width = listed.left[0].image.read().shape
        return listed.calibrate((width, height)).rig
    except VoError:
        return None


def _truth_alone(listed: Gathered) -> Trajectory | None:
    """The true poses, if they are of the camera, which then need not be known."""
    try:
        return listed.read_truth(Calibration(Rig(Camera(1, 1, 1.0, 1.0, 0.0, 0.0))))
    except (VoError, OSError, ValueError):
        return None


def _log_at(
    path: Path, name: str, calibration: Path | None, mode: Mode, wishes: Sequence[str]
) -> Material:
    log = open_container(path, name)
    found = Material(
        path,
        name,
        topics=_with_own_spans(log),
        unread=tuple(log.unread),
        imus=tuple(log_imus(log, imu_topics(log.topics), lambda _: None)),
    )
    try:
        choice = choose_topics(log.topics, wishes, mode)
    except SourceError as error:
        images = [topic for topic in log.topics if issubclass(topic.codec.kind, IMAGE_KINDS)]
        cameras = _cameras(log, {topic.name: topic for topic in images})
        return replace(found, cameras=cameras, is_decided=False, refusal=str(error))
    chosen = {"cam0": choice.left}
    if choice.right is not None and mode != "mono":
        chosen["cam1"] = choice.right
    found = replace(found, cameras=_cameras(log, chosen))
    try:
        source = open_log(log, name, calibration, mode, wishes)
    except VoError as error:
        return replace(found, refusal=str(error))
    return replace(
        found, source=source, rig=source.rig, truth=source.ground_truth, imus=source.imus
    )


def _with_own_spans(log: Log) -> tuple[Topic, ...]:
    """Topics whose rates are exact: an MCAP's summary only knows the span of the whole file."""
    entries = log.entries([topic.name for topic in log.topics])
    spans_ns = {
        name: max(e.log_ns for e in listed) - min(e.log_ns for e in listed) if listed else 0
        for name, listed in entries.items()
    }
    return tuple(replace(topic, span_ns=spans_ns[topic.name]) for topic in log.topics)


def _cameras(log: Log, topics: dict[str, Topic]) -> tuple[CameraShots, ...]:
    entries = log.entries([topic.name for topic in topics.values()])
    cameras = []
    for name, topic in topics.items():
        try:
            shots = list_images(log, topic, entries[topic.name])
        except SourceError:
            continue
        cameras.append(CameraShots(name, shots, len(entries[topic.name]) - len(shots)))
    return tuple(cameras)


def right_stamps(left: Sequence[Shot], right: Sequence[Shot]) -> Ints:
    """(N,) the stamp of each left image's partner, -1 where it has none."""
    stamp_of: dict[int, int] = {id(shot.image): shot.stamp_ns for shot in right}
    partners: list[StoredImage | None] = pair_by_stamp(left, right)
    return np.array([-1 if p is None else stamp_of[id(p)] for p in partners], dtype=np.int64)


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """Inside, warnings are collected and not shown."""
    lines: list[str] = []
    handler = _Collector(lines)
    logger = logging.getLogger("vo")
    spread = logger.propagate
    logger.addHandler(handler)
    logger.propagate = False
    try:
        yield lines
    finally:
        logger.removeHandler(handler)
        logger.propagate = spread


class _Collector(logging.Handler):
    def __init__(self, lines: list[str]) -> None:
        super().__init__(logging.WARNING)
        self._lines = lines

    def emit(self, record: logging.LogRecord) -> None:
        self._lines.append(" ".join(record.getMessage().split()))
