"""Recordings without their calibration, as input of camera calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.base.types import Camera, Mode, Rig
from vo.recordings.formats.calibration import Calibration, ImageSize
from vo.recordings.sources.assembly import RecordingContents, assemble
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.logs.choice import choose_topics
from vo.recordings.sources.logs.images import list_images
from vo.recordings.sources.logs.imu import imu_topics, log_imus
from vo.recordings.sources.registry import FORMATS, choose_format, gather, open_container
from vo.recordings.sources.sequence import ImageSequence
from vo.recordings.sources.side_by_side import not_side_by_side, split_side_by_side


def open_uncalibrated(
    path: Path | str,
    *,
    format: str | None = None,
    mode: Mode = "auto",
    topics: Sequence[str] = (),
    right_offset_ns: int | None = None,
    side_by_side: bool = False,
) -> ImageSequence:
    """Open a recording with unknown calibration.

    The cameras of its rig are placeholders: only their image size is meaningful. Ground truth and
    depth are left out.
    """
    path = Path(path)
    name = choose_format(path, format)
    if side_by_side and FORMATS[name].has_topics:
        raise not_side_by_side(path, name)
    if FORMATS[name].has_topics:
        contents = _gather_log(path, name, mode, topics)
    elif topics:
        raise SourceError(f"{path} ({name}) has no topics; leave `topics` out")
    else:
        contents = gather(path, name, None, mode)
    if side_by_side:
        contents = split_side_by_side(contents)
    right = None if mode == "mono" else contents.right
    return assemble(
        replace(
            contents,
            right=right,
            further=(),
            calibrate=lambda size: Calibration(_placeholder(size, right)),
            read_truth=lambda _: None,
            depth=None,
            right_offset_ns=right_offset_ns,
        ),
        mode,
    )


def _gather_log(path: Path, name: str, mode: Mode, topics: Sequence[str]) -> RecordingContents:
    log = open_container(path, name)
    choice = choose_topics(log.topics, topics, mode)
    chosen = [choice.left] if choice.right is None else [choice.left, choice.right]
    entries = log.entries([topic.name for topic in chosen])
    left, *others = (list_images(log, topic, entries[topic.name]) for topic in chosen)
    return RecordingContents(
        name=path.resolve().stem,
        format=name,
        left=left,
        right=others[0] if others else None,
        calibrate=lambda size: Calibration(_placeholder(size, None)),
        find_imus=lambda _: log_imus(log, imu_topics(log.topics, choice.imu), lambda _: None),
    )


def _placeholder(size: ImageSize, right: Sequence[Shot] | None) -> Rig:
    width, height = size
    camera = Camera(width, height, width, width, (width - 1) / 2, (height - 1) / 2)
    if not right:
        return Rig(camera)
    other = _size_of_any(right)
    if other != size:
        raise SourceError(
            f"left images are {width}x{height}, right ones such as {right[0].image.name} "
            f"{other[0]}x{other[1]}; both must have the same size (for one camera: `mode=mono`)"
        )
    return Rig(camera, camera, np.eye(4))


def _size_of_any(shots: Sequence[Shot]) -> ImageSize:
    for shot in shots:
        try:
            height, width = shot.image.read().shape
        except SourceError:
            continue
        return width, height
    raise SourceError(f"none of {len(shots)} right images can be read; use `mode=mono`")
