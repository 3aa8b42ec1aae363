"""Run the odometry on a recording: open, track, write and record, summarise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace
from pathlib import Path
from subprocess import Popen
from typing import TypedDict, Unpack

import numpy as np

from vo.base.config import Config, dump_config
from vo.base.errors import CalibrationError, ConfigError, SourceError, VoError
from vo.base.extras import require
from vo.base.images.image_areas import split_cameras
from vo.base.records.inertial_use import InertialUse
from vo.base.records.metric_scale import ScaleSource
from vo.base.types import Mode
from vo.engine.odometry import Odometry
from vo.engine.stages import BUILT_IN, Components
from vo.engine.trajectory.interpolation import InterpolatedFrames
from vo.outputs.recorders.exports import Exports, with_exports
from vo.outputs.recorders.recorder import ImageChoice, NullRecorder, Recorder
from vo.outputs.results.folder import RESULTS, RunFolder
from vo.outputs.results.output_lock import locked_folder
from vo.outputs.results.output_paths import refuse_to_collide, refuse_to_overwrite
from vo.outputs.results.summary import Summary
from vo.outputs.streaming.sink import PoseSink
from vo.outputs.streaming.streams import opened_streams
from vo.recordings.sources.imu import usable_noise
from vo.recordings.sources.live.address import LiveAddress, parse_address
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.source import FrameStream, LiveStream, Recording
from vo.runs.inertial_checks import Unusable, why_unusable
from vo.runs.progress import NullProgress, Progress
from vo.runs.run_session import Request, RunSession
from vo.runs.scaling.creation import ScaleOptions, make_scale_sources


class RunOptions(TypedDict, total=False):
    """Options of `run`, all optional.

    Attributes:
        mode: `mono` ignores the right camera, `stereo` requires it; by default `auto`.
        start: first frame.
        end: frame to stop before.
        stride: step between frames.
        calibration: file that replaces the recording's calibration.
        format: of the recording; by default detected from the path.
        topics: of a log, `left=/a` and `right=/b`, or a single name; by default detected.
        right_offset_ns: added to the stamps of right images before they are paired; by default the
            constant offset of all right stamps, if there is one.
        save_map: file for the stored keyframes and where they are; not with `memory.loops=false`.
        follow: whether the log is still being written; frames are tracked as they arrive.
        side_by_side: whether each image has the left and the right one beside each other.
        timeout_s: time without images after which a run on a live source ends; by default 10 s.
        duration_s: time after which it ends anyway.
        record: MCAP file to which its frames are written.
        source_name: name of the recording in the summary, instead of its path.
        rrd: file to record for the rerun viewer.
        rrd_images: size of its images, and of those streamed to `viewer`; by default `half`.
        viewer: URL of a rerun viewer to stream to.
        recorder: recorder to use instead of `rrd` and `viewer`.
        exports: files for other programs.
        poses: where to send each pose at once: `-`, `udp://HOST:PORT`, `ws://HOST:PORT`, or a sink.
        components: parts of the odometry to use instead of the built-in ones.
        progress: observer of the run.
        profile_since: write a profile that begins at this time of `time.perf_counter`.
        optimizer_process: that of `vo.engine.backend.launch`, if it was started already.
        scale: what measures the scale of a mono path, which is converted to metres.
        scale_sources: further sources of scale, of a program of one's own.
    """

    mode: Mode
    start: int
    end: int | None
    stride: int
    calibration: Path | None
    format: str | None
    topics: Sequence[str]
    right_offset_ns: int | None
    follow: bool
    save_map: Path | None
    side_by_side: bool
    timeout_s: float | None
    duration_s: float | None
    record: Path | None
    source_name: str | None
    rrd: Path | None
    rrd_images: ImageChoice
    viewer: str | None
    recorder: Recorder | None
    exports: Exports | None
    poses: Sequence[str | PoseSink]
    components: Components
    progress: Progress | None
    profile_since: float | None
    optimizer_process: Popen[bytes] | None
    scale: ScaleOptions
    scale_sources: Sequence[ScaleSource]


def run(
    source: str | Path | FrameStream,
    output: Path,
    *,
    config: Config,
    **options: Unpack[RunOptions],
) -> Summary:
    """Compute a camera's path from a recording and write it as it grows.

    However the run ends, the folder holds what was computed until then, and a summary that says
    how it ended: Ctrl-C and errors finish the files before they are raised again; after a kill
    the files have `.partial` after their names.

    Args:
        source: folder or file of the recording, address of a live source (docs/live.md), or a
            stream of frames.
        output: folder for the results (docs/outputs.md); those of an earlier run are removed.
        config: all settings.
        **options: see `RunOptions`.

    Raises:
        SourceError: the recording is missing, damaged, or has no readable frame.
        CalibrationError: its calibration is missing or implausible.
        ConfigError: `tracking.every` is above 1 for a stream, or a log that is followed; a mask
            cannot be used.
        OutputError: the folder or the recording cannot be written, another run is writing there,
            it holds files of others with names of a run's, two outputs are the same file or
            one is an input, the map is of another camera and cannot be saved, no viewer answers,
            or poses cannot be sent.
        KeyboardInterrupt: a stop signal came before the last frame, or the reader of the poses on
            standard output is gone.
    """
    exports = options.get("exports") or Exports()
    _check_outputs(source, output, config, exports, options)
    stream = _open(source, config, options)
    _check_readout(stream, config)
    request, components = _with_imu(stream, _request(source, stream, config, options), options)
    every, is_live = config.tracking.every, isinstance(stream, LiveStream)
    frames = stream.frames(request.start, request.end, request.stride * every)
    process, decided = options.get("optimizer_process"), _with_loops(config, options, is_live)
    with (
        _disconnected_at_end(stream),
        opened_streams(options.get("poses", ())) as poses,
        locked_folder(Path(output)),
        closing(Odometry(stream.rig, decided, components, process)) as odometry,
    ):
        save_map = options.get("save_map")
        if save_map is not None:
            odometry.placement.check_savable(save_map)
        if every > 1 and isinstance(stream, Recording):
            interpolated = InterpolatedFrames(stream.stamps_ns, request.stride, every)
            odometry.trajectory.interpolated = interpolated
        recorder = with_exports(_recorder(options, is_live=is_live), exports, may_drop=is_live)
        # rerun and MCAP accept no other bytes
        name = stream.name.encode("utf-8", "replace").decode()
        recorder.begin(name, stream.rig, stream.ground_truth)
        folder = RunFolder(Path(output), dump_config(config))  # last: it clears an earlier run
        progress = options.get("progress") or NullProgress()
        session = RunSession(stream, request, odometry, folder, recorder, progress, poses)
        return session.run(frames)


def _with_loops(config: Config, options: RunOptions, is_live: bool) -> Config:
    """The settings with `memory.loops` decided, if it is `auto`."""
    memory, features = config.memory, config.features
    if memory.loops != "auto":
        return config
    is_wanted = memory.map != "" or options.get("save_map") is not None
    is_orb = features.detector == "orb" and features.descriptor in ("auto", "rbrief")
    loops = is_wanted or (is_orb and not is_live)
    return config.model_copy(update={"memory": memory.model_copy(update={"loops": loops})})


def _check_outputs(
    source: str | Path | FrameStream,
    output: Path,
    config: Config,
    exports: Exports,
    options: RunOptions,
) -> None:
    """Refuse outputs that would overwrite the input, files of others, or each other."""
    if options.get("save_map") is not None and not config.memory.loops:
        raise ConfigError("--save-map needs loops; leave out --no-loops")
    memory = config.memory
    if memory.map and not memory.loops:
        raise ConfigError("--map needs loops; leave out --no-loops")
    if memory.localize and not memory.map:
        raise ConfigError("--localize finds poses in a map; give it by --map FILE")
    if memory.localize and options.get("save_map") is not None:
        raise ConfigError("--localize adds nothing to the map; leave out --save-map")
    rrd = options.get("rrd")
    path = Path(source) if isinstance(source, str | Path) else None
    files = (rrd, exports.mcap, exports.ply, exports.colmap, options.get("record"))
    save_map = options.get("save_map")
    masks = [Path(split_cameras(text)[1]) for text in config.masks.files]
    vocabulary = Path(memory.vocabulary) if memory.vocabulary else None
    inputs = (path, options.get("calibration"), vocabulary, *masks)
    refuse_to_overwrite(inputs, (Path(output), *files, save_map))
    markers = None if options.get("scale") is None else options["scale"].marker_map
    results = [Path(output) / name for name in RESULTS]  # also a markers.csv of an earlier run
    refuse_to_overwrite([markers], (*files, save_map, *results))
    # Only the new map may replace the old one.
    refuse_to_overwrite([Path(memory.map) if memory.map else None], (Path(output), *files))
    refuse_to_collide(Path(output), (*files, save_map))


def _check_readout(stream: FrameStream, config: Config) -> None:
    """Refuse a readout time that is longer than the time between frames."""
    given, calibrated_s = config.camera.readout_s, stream.rig.cam0.readout_s
    readout_s = calibrated_s if given is None else given
    if readout_s == 0.0 or not isinstance(stream, Recording) or len(stream) < 2:
        return
    interval_s = 1e-9 * float(np.median(np.diff(stream.stamps_ns)))
    if readout_s > interval_s > 0.0:
        name = "readout_s of the calibration" if given is None else "camera.readout_s"
        raise CalibrationError(
            f"{name} is {readout_s:g} s, but frames are {interval_s:.3g} s apart; give the time "
            "from the first to the last row of an image, or 0 for a global shutter"
        )


def _open(source: str | Path | FrameStream, config: Config, options: RunOptions) -> FrameStream:
    every, follow = config.tracking.every, options.get("follow", False)
    if every > 1 and (follow or not isinstance(source, str | Path | Recording)):
        what = "a log that is followed" if follow else "a stream"
        raise ConfigError(f"tracking.every is {every}; {what} needs 1")
    if not isinstance(source, str | Path):
        return source
    address = parse_address(str(source))
    if address is not None:
        return _open_live(address, config, options)
    for option, value in _live_options(options).items():
        if value is not None:
            raise SourceError(f"--{option} is for live sources, and {source} is a recording")
    return open_source(
        source,
        format=options.get("format"),
        calibration=options.get("calibration"),
        mode=options.get("mode", "auto"),
        topics=options.get("topics", ()),
        follow=follow,
        right_offset_ns=options.get("right_offset_ns"),
        side_by_side=options.get("side_by_side", False),
    )


def _open_live(address: LiveAddress, config: Config, options: RunOptions) -> FrameStream:
    from vo.recordings.sources.live.opening import (  # seldom needed
        DEFAULT_TIMEOUT_S,
        LiveOptions,
        open_live,
    )

    name = address.public_name
    if config.tracking.every > 1:
        raise ConfigError(f"tracking.every is {config.tracking.every}; a live source needs 1")
    for option in ("format", "topics", "right_offset_ns", "follow"):
        if options.get(option) not in (None, False, (), []):
            word = {"topics": "topic", "right_offset_ns": "right-offset"}.get(option, option)
            raise SourceError(f"--{word} is for recordings, and {name} is a live source")
    timeout_s, duration_s = options.get("timeout_s"), options.get("duration_s")
    live = LiveOptions(
        options.get("side_by_side", False),
        DEFAULT_TIMEOUT_S if timeout_s is None else timeout_s,
        math.inf if duration_s is None else duration_s,
    )
    stream = open_live(address, options.get("calibration"), options.get("mode", "auto"), live)
    record = options.get("record")
    if record is not None:
        from vo.outputs.recorders.frame_log import FrameLog  # protobuf takes long to import

        try:
            stream.tap = FrameLog(Path(record), stream.rig)
        except VoError:
            stream.close()
            raise
    return stream


def _with_imu(
    stream: FrameStream, request: Request, options: RunOptions
) -> tuple[Request, Components]:
    """The parts of the odometry with the inertial sensor, or the request with why it is not."""
    components, config = options.get("components", BUILT_IN), request.config
    if not config.inertial.enabled or components.inertial_sensor is not None:
        return request, components
    if options.get("follow", False) or not isinstance(stream, Recording) or not stream.imus:
        return request, components
    sensor = stream.imus[0]
    if request.scale.all and not stream.rig.is_metric:
        unused = InertialUse(sensor.name, "it cannot be combined with another source of the scale")
        return replace(request, unused_imu=unused), components
    try:
        unusable = why_unusable(sensor, stream.stamps_ns)
    except SourceError as error:
        unusable = Unusable(str(error))
    if unusable is not None:
        unused = InertialUse(sensor.name, unusable.reason, unusable.is_error)
        return replace(request, unused_imu=unused), components
    noise = usable_noise(sensor)
    return request, components._replace(inertial_sensor=sensor, inertial_noise=noise)


def _live_options(options: RunOptions) -> dict[str, object]:
    """Options that only live sources have, by their names in the command line."""
    return {
        "timeout": options.get("timeout_s"),
        "duration": options.get("duration_s"),
        "record": options.get("record"),
    }


def _disconnected_at_end(stream: FrameStream) -> AbstractContextManager[object]:
    return closing(stream) if isinstance(stream, LiveStream) else nullcontext()


def _request(
    source: str | Path | FrameStream, stream: FrameStream, config: Config, options: RunOptions
) -> Request:
    path = stream.name
    if isinstance(source, str | Path) and not isinstance(stream, LiveStream):
        path = str(Path(source))
    return Request(
        path,
        options.get("source_name") or path,
        config,
        options.get("start", 0),
        options.get("end"),
        options.get("stride", 1),
        options.get("calibration"),
        tuple(options.get("topics", ())),
        options.get("right_offset_ns"),
        options.get("follow", False),
        options.get("save_map"),
        options.get("profile_since"),
        make_scale_sources(
            options.get("scale") or ScaleOptions(),
            options.get("scale_sources", ()),
            stream,
            path if isinstance(source, str | Path) else None,
        ),
    )


def _recorder(options: RunOptions, *, is_live: bool) -> Recorder:
    given, rrd, viewer = options.get("recorder"), options.get("rrd"), options.get("viewer")
    if given is not None:
        return given
    if rrd is None and viewer is None:
        return NullRecorder()
    require("rerun", extra=None, what="recordings for the viewer")
    from vo.outputs.recorders.background import BackgroundRecorder
    from vo.outputs.recorders.rerun_recorder import RerunRecorder  # importing rerun takes long

    images = options.get("rrd_images", "half")
    recorder = RerunRecorder(rrd, images=images, viewer=viewer)
    return BackgroundRecorder(recorder, may_drop=viewer is not None or is_live)
