"""Options of a run."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import field
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Self, Union, get_args, get_origin, get_type_hints

import numpy as np

from vo.base.errors import ConfigError
from vo.base.frozen import frozen
from vo.base.option_names import Flag
from vo.base.records.metric_scale import ScaleSource
from vo.base.settings import nearest
from vo.base.types import Mode
from vo.engine.stages import BUILT_IN, Components
from vo.outputs.recorders.exports import Exports
from vo.outputs.recorders.recorder import ImageChoice, Recorder
from vo.outputs.streaming.sink import PoseSink
from vo.runs.progress import Progress
from vo.runs.scaling.scale_sources import ScaleOptions

_NAMES: dict[Any, str] = {
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "a text",
    Path: "a path",
    NoneType: "None",
}


@frozen(kw_only=True)
class RunOptions:
    """Options of `run`, all optional; files may be given as text.

    Attributes:
        mode: `mono` ignores the right camera, `stereo` requires it.
        start: first frame.
        end: frame to stop before.
        stride: step between frames.
        calibration: file that replaces the recording's calibration.
        format: of the recording; by default detected from the path.
        topics: of a log, `left=/a` and `right=/b`, or a single name; by default detected.
        right_offset_ns: added to the stamps of right images before they are paired; by default the
            constant offset of all right stamps, if there is one.
        follow: whether the log is still being written; frames are tracked as they arrive.
        side_by_side: whether each image has the left and the right one beside each other.
        timeout_s: time without images after which a run on a live source ends; by default 10 s.
        duration_s: time after which it ends anyway.
        record: MCAP file to which its frames are written.
        source_name: name of the recording in the summary, instead of its path.
        rrd: file to record for the rerun viewer.
        rrd_images: size of its images, and of those streamed to `viewer`.
        viewer: URL of a rerun viewer to stream to.
        recorder: recorder to use instead of `rrd` and `viewer`.
        exports: files for other programs.
        save_map: file for the stored keyframes and where they are; not with `memory.loops=false`.
        save_calibration: file for the calibration that is used; an estimated one is written into
            the output otherwise.
        poses: where to send each pose at once: `-`, `udp://HOST:PORT`, `ws://HOST:PORT`, or a sink.
        allow_hosts: to which redirects and playlists of a live stream may lead besides its own.
        allow_origins: web pages, such as `https://example.org`, that may read poses from `ws://`,
            besides those of this machine and of Foxglove.
        components: parts of the odometry to use instead of the built-in ones.
        progress: observer of the run.
        profile_since: write a profile that begins at this time of `time.perf_counter`.
        gps: positions of another sensor, which move the path and give its scale: a file,
            `LOG:/TOPIC` or `auto`.
        scale: what measures the scale of a mono path, which is converted to metres.
        scale_sources: further sources of scale, of a program of one's own.
        flags: how a command line gives options; its warnings name them so.
    """

    mode: Mode = "auto"
    start: int = 0
    end: int | None = None
    stride: int = 1
    calibration: Path | None = None
    format: str | None = None
    topics: Sequence[str] = ()
    right_offset_ns: int | None = None
    follow: bool = False
    side_by_side: bool = False
    timeout_s: float | None = None
    duration_s: float | None = None
    record: Path | None = None
    allow_hosts: Sequence[str] = ()
    source_name: str | None = None
    rrd: Path | None = None
    rrd_images: ImageChoice = "half"
    viewer: str | None = None
    recorder: Recorder | None = None
    exports: Exports | None = None
    save_map: Path | None = None
    save_calibration: Path | None = None
    poses: Sequence[str | PoseSink] = ()
    allow_origins: Sequence[str] = ()
    components: Components = BUILT_IN
    progress: Progress | None = None
    profile_since: float | None = None
    gps: str | None = None
    scale: ScaleOptions = field(default_factory=ScaleOptions)
    scale_sources: Sequence[ScaleSource] = ()
    flags: Mapping[str, Flag] = field(default_factory=dict)

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """The options given by name.

        Raises:
            ConfigError: an option is unknown, or its value is of another type.
        """
        return cls(**checked_options(given, get_type_hints(cls)))


def checked_options(given: Mapping[str, Any], kinds: Mapping[str, Any]) -> dict[str, Any]:
    """Options by name, with texts of files as paths.

    Raises:
        ConfigError: an option is unknown, or its value is not of its type in `kinds`.
    """
    checked: dict[str, Any] = {}
    for name, value in given.items():
        if name not in kinds:
            raise ConfigError(f"unknown option '{name}'{nearest(name, list(kinds))}")
        if not _is(value, kinds[name]):
            shown = " ".join(repr(value)[:80].split())
            raise ConfigError(f"the option {name} is {shown}, not {_name(kinds[name])}")
        is_path = isinstance(value, str) and Path in get_args(kinds[name])
        checked[name] = Path(value) if is_path else value
    return checked


def _is(value: object, kind: Any) -> bool:
    """Whether a value is of an annotated type; of a protocol, any object."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return any(_is(value, each) for each in parts)
    if origin is Literal:
        return value in parts
    if origin is Sequence:
        return isinstance(value, list | tuple) and all(_is(each, parts[0]) for each in value)
    if kind is bool:
        return isinstance(value, bool | np.bool_)
    if kind in (int, float):
        number = Integral if kind is int else Real
        return isinstance(value, number) and not isinstance(value, bool)
    if getattr(kind, "_is_protocol", False):
        return value is not None and not isinstance(value, str | int | float)
    return isinstance(value, str | os.PathLike if kind is Path else origin or kind)


def _name(kind: Any) -> str:
    """A type in words."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        named = [each for each in parts if each is not str or Path not in parts]
        return " or ".join(dict.fromkeys(map(_name, named)))
    if origin is Literal:
        return f"one of {', '.join(map(repr, parts))}"
    if origin is Sequence:
        return f"a list, each {_name(parts[0])}"
    return _NAMES.get(kind) or str(getattr(origin or kind, "__name__", kind))
