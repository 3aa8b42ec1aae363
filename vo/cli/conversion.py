"""From any recording to one that the generator's writers put on disk."""

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
from vo.cli.conversion_imu import imu_around
from vo.cli.conversion_size import Size, resized, resized_depth, scaled_rig
from vo.cli.conversion_truth import around, body_truth, no_poses, poses_at, settle_truth
from vo.errors import ConfigError, OutputError, SourceError
from vo.geometry.transforms import inverse
from vo.inspection.opening import OpenedRecording, collected_warnings, right_stamps
from vo.sources.images import ImageKind, is_in_colour
from vo.sources.sequence import choose_frames
from vo.sources.source import Source
from vo.types import Frame, Ints, Rig, Trajectory

OnFrame = Callable[[int, int], None]
_NS_PER_S = 1e9


@dataclass(frozen=True)
class Conversion:
    """What is to become of a recording.

    Attributes:
        format: a key of the writers' `FORMATS`.
        codec: `png`, `jpeg` or `raw`.
        start: first frame.
        end: frame to stop before; None for the last.
        stride: take every so many frames.
        size: width and height of all images, or a factor; None leaves them.
        gray: grey images with 8 bits, as the odometry sees them; else as they were recorded.
    """

    format: str
    codec: str
    start: int = 0
    end: int | None = None
    stride: int = 1
    size: Size | None = None
    gray: bool = False

    @property
    def images(self) -> ImageKind:
        """What images are read as; JPEG has no room for 16 bits."""
        if self.gray:
            return "grey"
        return "colour" if self.codec == "jpeg" else "recorded"


@dataclass(frozen=True, eq=False)
class _Plan:
    """The frames to write: numbers in the source, left and right stamps (-1: no right image)."""

    numbers: Ints
    left_ns: Ints
    right_ns: Ints
    unreadable: set[int] = field(default_factory=set)
    right_unreadable: set[int] = field(default_factory=set)


class _UnreadableError(Exception):
    """An image that was listed turned out to be damaged while it was written."""


def convert(
    opened: OpenedRecording,
    output: Path,
    how: Conversion,
    *,
    force: bool = False,
    on_frame: OnFrame | None = None,
) -> Recording:
    """Write a recording anew; it appears when it is whole.

    Args:
        opened: the recording, opened.
        output: folder or, for MCAP, file to make.
        how: what to change.
        force: replace a file that is there.
        on_frame: called with the frames done and their total.

    Raises:
        SourceError: a run would refuse the recording, or the numbers choose no frame.
        ConfigError: the layout cannot hold it.
        OutputError: there is something already, or the place cannot be written.
    """
    source = opened.source
    if source is None:
        raise SourceError(opened.refusal.splitlines()[0])
    _refuse_existing(output, force)
    plan = _plan(opened, source, how)
    truth = around(plan.left_ns, source.ground_truth)
    _check(_recording(source, truth, plan, how), how)
    imu, body_from_cam0 = imu_around(source, plan.left_ns, how.format)
    has_colour = not how.gray and is_in_colour([s.image for s in opened.cameras[0].shots])
    while True:
        recording = replace(
            _recording(source, truth, plan, how),
            imu=imu,
            body_from_cam0=body_from_cam0,
            body_truth=body_truth(truth, inverse(body_from_cam0)),
            has_colour=has_colour,
        )
        _check(recording, how)
        try:
            with _whole(output, force) as partial:
                shots = _shots(source, plan, how, on_frame)
                load_writer(how.format)(partial, recording, shots, how.codec)
                settle_truth(partial, how.format, recording, truth)
            return recording
        except _UnreadableError:  # now that it is known which are damaged, they can be left out
            _find_unreadable(source, plan)


def _plan(opened: OpenedRecording, source: Source, how: Conversion) -> _Plan:
    chosen = choose_frames(len(source), how.start, how.end, how.stride)
    numbers = np.array(chosen, dtype=np.int64)
    right_ns = np.full(len(numbers), -1, dtype=np.int64)
    if source.rig.is_stereo:
        left, right = opened.cameras
        with collected_warnings():  # they were said when it was opened
            right_ns = right_stamps(left.shots, right.shots)[numbers]
    left_ns = source.stamps_ns[numbers]
    if left_ns[0] < 0:
        raise SourceError(f"stamps begin at {left_ns[0]} ns; only those from 0 on can be written")
    return _Plan(numbers, left_ns, right_ns)


def _recording(source: Source, truth: Trajectory | None, plan: _Plan, how: Conversion) -> Recording:
    """The recording but for its inertial sensor; its body is cam0."""
    rig = scaled_rig(source.rig, how.size)
    no_left = np.isin(plan.numbers, list(plan.unreadable))
    stamps, dropped = [plan.left_ns], [no_left]
    if rig.is_stereo:
        no_right = (plan.right_ns < 0) | no_left
        no_right |= np.isin(plan.numbers, list(plan.right_unreadable))
        stamps.append(np.where(plan.right_ns < 0, plan.left_ns, plan.right_ns))
        dropped.append(no_right)
    interval = np.median(np.diff(plan.left_ns)) if len(plan.left_ns) > 1 else _NS_PER_S
    is_log = how.format.startswith("mcap")
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


def _check(recording: Recording, how: Conversion) -> None:
    """Refuse what the layout cannot hold."""
    known = FORMATS[how.format]
    if how.codec not in known.codecs:
        raise ConfigError(
            f"format {how.format} cannot hold images as {how.codec}; choose --codec "
            f"{' or '.join(known.codecs)}"
        )
    if how.format == "kitti" and any(dropped.any() for dropped in recording.dropped):
        alone = int(np.sum([dropped.sum() for dropped in recording.dropped]))
        raise ConfigError(
            f"format kitti cannot say which images are missing, and {alone} are; choose "
            "--format euroc, which can, or --mode mono"
        )
    if how.format == "tum" and not recording.has_depth:
        raise ConfigError(
            "format tum holds one camera with depth, and there is none; choose --format euroc"
        )
    known.check(recording.rig, False)


def _shots(
    source: Source, plan: _Plan, how: Conversion, on_frame: OnFrame | None
) -> Iterator[Shot]:
    """The frames as they are to be written, each exactly once and in order."""
    rig = scaled_rig(source.rig, how.size)
    total, done = len(plan.numbers), 0
    for frame in source.frames(how.start, how.end, how.stride, how.images):
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
    images: list[Pixels | None] = [resized(frame.image0, rig.cam0)]
    if rig.cam1 is not None:
        right = None if frame.image1 is None else resized(frame.image1, rig.cam1)
        is_listed = plan.right_ns[row] >= 0 and frame.index not in plan.right_unreadable
        if right is None and is_listed:
            raise _UnreadableError
        images.append(right)
    depth = None
    if rig.has_depth:
        unknown = np.zeros((rig.cam0.height, rig.cam0.width), dtype=np.float32)
        depth = unknown if frame.depth is None else resized_depth(frame.depth, rig.cam0)
    return Shot(row, tuple(images), depth)


def _missing(plan: _Plan, row: int, rig: Rig) -> Shot:
    if int(plan.numbers[row]) not in plan.unreadable:
        raise _UnreadableError
    return Shot(row, (None, None) if rig.is_stereo else (None,))


def _find_unreadable(source: Source, plan: _Plan) -> None:
    """Go through all frames and note what cannot be read."""
    first, last = int(plan.numbers[0]), int(plan.numbers[-1])
    stride = int(plan.numbers[1] - first) if len(plan.numbers) > 1 else 1
    right_ns = dict(zip(plan.numbers.tolist(), plan.right_ns.tolist(), strict=True))
    read = set()
    for frame in source.frames(first, last + 1, stride):
        read.add(frame.index)
        if source.rig.is_stereo and frame.image1 is None and right_ns[frame.index] >= 0:
            plan.right_unreadable.add(frame.index)
    plan.unreadable.update(set(plan.numbers.tolist()) - read)


def _refuse_existing(path: Path, force: bool) -> None:
    taken = path.exists() and (not path.is_dir() or any(path.iterdir()))
    if taken and (path.is_dir() or not force):
        hint = "remove it first" if path.is_dir() else "or --force to replace it"
        raise OutputError(f"{path} is there already; give another name, {hint}")


@contextmanager
def _whole(path: Path, force: bool) -> Iterator[Path]:
    """A place beside that takes the name of `path` at the end, or vanishes."""
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
