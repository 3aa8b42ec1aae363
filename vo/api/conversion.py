"""Conversion of a recording to a format of the synthetic generator's writers."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from data_synth.records import Pixels, Recording, Shot
from data_synth.writers.registry import FORMATS, load_writer
from vo.api.conversion_ground_truth import (
    body_truth,
    no_poses,
    poses_around,
    poses_at,
    write_original_truth,
)
from vo.api.conversion_imu import imu_around
from vo.api.conversion_size import Size, resized, resized_depth, scaled_rig
from vo.base.errors import ConfigError, OutputError, SourceError
from vo.base.geometry.transforms import inverse
from vo.base.types import Frame, Ints, Rig, Trajectory
from vo.recordings.formats.warning_kinds import collected_warnings
from vo.recordings.sources.images import ImageKind, is_colour
from vo.recordings.sources.sequence import ImageSequence, select_frames
from vo.recordings.sources.source import Recording as SourceRecording
from vo.tools.inspection.opening import OpenedRecording, right_stamps

OnFrame = Callable[[int, int], None]
_NS_PER_S = 1e9
_MAX_LATE_MS = 1.0  # as where a rig is read: cameras with a common trigger


@dataclass(frozen=True)
class Conversion:
    """Settings of a conversion; a size is that of all images, or a factor."""

    format: str
    codec: str
    start: int = 0
    end: int | None = None
    stride: int = 1
    size: Size | None = None
    gray: bool = False

    @property
    def images(self) -> ImageKind:
        """Kind of images to read; JPEG does not support 16 bits."""
        if self.gray:
            return "grey"
        return "colour" if self.codec == "jpeg" else "recorded"


@dataclass(frozen=True, eq=False)
class _Plan:
    """The frames to write.

    Attributes:
        numbers: (F,) in the source.
        left_ns: (F,) stamps of the frames, those of the first camera's images where it has them.
        stamps_ns: (F,) of each camera, -1 without an image.
        unreadable: numbers of frames and their camera, without those that are lost.
        lost: numbers of frames that cannot be read.
    """

    numbers: Ints
    left_ns: Ints
    stamps_ns: tuple[Ints, ...]
    unreadable: set[tuple[int, int]] = field(default_factory=set)
    lost: set[int] = field(default_factory=set)


class _UnreadableError(Exception):
    """A listed image could not be read during the conversion."""


def convert(
    opened: OpenedRecording,
    output: Path,
    settings: Conversion,
    *,
    force: bool = False,
    on_frame: OnFrame | None = None,
) -> Recording:
    """Write a recording in another format; the output appears when it is complete.

    Raises:
        SourceError: `vo run` would refuse the recording, or no frame is selected.
        ConfigError: the format cannot represent the recording.
        OutputError: the output exists already, or cannot be written.
    """
    source = opened.source
    if source is None:
        raise SourceError(opened.refusal)
    _refuse_existing(output, force)
    plan = _plan(opened, source, settings)
    truth = poses_around(plan.left_ns, source.ground_truth)
    _check(_recording(source, truth, plan, settings), settings)
    imu, body_from_cam0 = imu_around(source, plan.left_ns, settings.format)
    lefts = opened.cameras[0].shots
    has_colour = not settings.gray and is_colour([shot.image for shot in lefts])
    while True:
        recording = replace(
            _recording(source, truth, plan, settings),
            imu=imu,
            body_from_cam0=body_from_cam0,
            body_truth=body_truth(truth, inverse(body_from_cam0)),
            has_colour=has_colour,
        )
        _check(recording, settings)
        try:
            with _atomic_output(output) as partial:
                shots = _shots(source, plan, settings, on_frame)
                load_writer(settings.format)(partial, recording, shots, settings.codec)
                write_original_truth(partial, settings.format, recording, truth)
            return recording
        except _UnreadableError:  # find all unreadable images and start again without them
            _find_unreadable(source, plan)


def _plan(opened: OpenedRecording, source: ImageSequence, settings: Conversion) -> _Plan:
    chosen = select_frames(len(source), settings.start, settings.end, settings.stride)
    numbers = np.array(chosen, dtype=np.int64)
    left_ns = source.stamps_ns[numbers]
    if left_ns[0] < 0:
        raise SourceError(f"the first stamp is {left_ns[0]} ns; negative stamps cannot be written")
    by_camera = source.camera_stamps_ns
    if source.rig.is_stereo and not by_camera:
        left, right = opened.cameras
        with collected_warnings():  # repeated from opening
            by_camera = [source.stamps_ns, right_stamps(left.shots, right.shots)]
    own = (own_ns[numbers] for own_ns in by_camera or [source.stamps_ns])
    return _Plan(numbers, left_ns, tuple(own))


def _recording(
    source: SourceRecording, truth: Trajectory | None, plan: _Plan, settings: Conversion
) -> Recording:
    """The recording without inertial measurements, with cam0 as its body."""
    rig = scaled_rig(source.rig, settings.size)
    is_lost = np.isin(plan.numbers, list(plan.lost))
    stamps, dropped = [], []
    for camera, own_ns in enumerate(plan.stamps_ns):
        unreadable = [number for number, of in plan.unreadable if of == camera]
        stamps.append(np.where(own_ns < 0, plan.left_ns, own_ns))
        dropped.append((own_ns < 0) | is_lost | np.isin(plan.numbers, unreadable))
    interval = np.median(np.diff(plan.left_ns)) if len(plan.left_ns) > 1 else _NS_PER_S
    is_log = settings.format.startswith("mcap")
    return Recording(
        name=source.name,
        rig=rig,
        body_from_cam0=np.eye(4),
        fps=float(_NS_PER_S / interval),
        stamps_ns=tuple(stamps),
        dropped=tuple(dropped),
        cam0_truth=no_poses() if is_log else poses_at(plan.left_ns, truth),
        body_truth=body_truth(truth, np.eye(4)),
        imu=None,
        movers=(),
        has_depth=rig.has_depth,
    )


def _check(recording: Recording, settings: Conversion) -> None:
    """Refuse what the format cannot represent."""
    known = FORMATS[settings.format]
    if settings.codec not in known.codecs:
        raise ConfigError(
            f"format {settings.format} does not support codec {settings.codec}; use `codec` "
            f"{' or '.join(known.codecs)}"
        )
    if settings.format == "kitti" and any(dropped.any() for dropped in recording.dropped):
        missing = int(np.sum([dropped.sum() for dropped in recording.dropped]))
        raise ConfigError(
            f"format kitti does not allow missing images, and {missing} are missing; use "
            "`to=euroc`, or `mode=mono`"
        )
    if settings.format == "tum" and not recording.has_depth:
        raise ConfigError("format tum needs depth images, and there are none; use `to=euroc`")
    if settings.format == "folder" and recording.rig.further:
        _check_common_stamps(recording)
    known.check(recording.rig, False)


def _check_common_stamps(recording: Recording) -> None:
    """Refuse cameras without a common trigger, as a folder has the stamps of the first only."""
    first_ns = recording.stamps_ns[0]
    late_ms = max(1e-6 * float(np.abs(own - first_ns).max()) for own in recording.stamps_ns)
    if late_ms > _MAX_LATE_MS:
        raise ConfigError(
            "format folder has the stamps of the first camera only, and those of others differ by "
            f"up to {late_ms:.1f} ms; use `to=euroc`"
        )


def _shots(
    source: SourceRecording, plan: _Plan, settings: Conversion, on_frame: OnFrame | None
) -> Iterator[Shot]:
    """The frames to write, each exactly once and in order."""
    rig = scaled_rig(source.rig, settings.size)
    total, done = len(plan.numbers), 0
    for frame in source.frames(settings.start, settings.end, settings.stride, settings.images):
        while plan.numbers[done] != frame.index:
            yield _missing(plan, done, rig)
            done += 1
        yield _shot(frame, plan, done, rig)
        done += 1
        if on_frame is not None:
            on_frame(done, total)
    while done < total:
        yield _missing(plan, done, rig)
        done += 1


def _shot(frame: Frame, plan: _Plan, row: int, rig: Rig) -> Shot:
    images: list[Pixels | None] = []
    for camera, (lens, image) in enumerate(zip(rig.cameras, frame.images, strict=False)):
        is_listed = plan.stamps_ns[camera][row] >= 0
        if image is None and is_listed and (frame.index, camera) not in plan.unreadable:
            raise _UnreadableError
        images.append(None if image is None else resized(image, lens))
    depth = None
    if rig.has_depth:
        unknown = np.zeros((rig.cam0.height, rig.cam0.width), dtype=np.float32)
        depth = unknown if frame.depth is None else resized_depth(frame.depth, rig.cam0)
    return Shot(row, tuple(images), depth)


def _missing(plan: _Plan, row: int, rig: Rig) -> Shot:
    if int(plan.numbers[row]) not in plan.lost:
        raise _UnreadableError
    return Shot(row, (None,) * len(rig.cameras))


def _find_unreadable(source: SourceRecording, plan: _Plan) -> None:
    """Read all frames and record unreadable images."""
    first, last = int(plan.numbers[0]), int(plan.numbers[-1])
    stride = int(plan.numbers[1] - first) if len(plan.numbers) > 1 else 1
    row_of = {number: row for row, number in enumerate(plan.numbers.tolist())}
    plan.lost.update(row_of)
    for frame in source.frames(first, last + 1, stride):
        plan.lost.discard(frame.index)
        row = row_of[frame.index]
        for camera, (own_ns, image) in enumerate(zip(plan.stamps_ns, frame.images, strict=False)):
            if image is None and own_ns[row] >= 0:
                plan.unreadable.add((frame.index, camera))


def _refuse_existing(path: Path, force: bool) -> None:
    exists = path.exists() and (not path.is_dir() or any(path.iterdir()))
    if exists and (path.is_dir() or not force):
        hint = "remove it first" if path.is_dir() else "replace it with `force=true`"
        raise OutputError(f"{path} exists already; give another name, or {hint}")


@contextmanager
def _atomic_output(path: Path) -> Iterator[Path]:
    """Temporary path beside `path`, renamed to it at the end, or removed after an error."""
    partial = path.parent / f".{path.name}.partial-{os.getpid()}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        if path.is_dir():
            path.rmdir()
        os.replace(partial, path)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        if partial.is_dir():
            shutil.rmtree(partial, ignore_errors=True)
        with suppress(FileNotFoundError):
            partial.unlink()
