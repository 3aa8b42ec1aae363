"""Run the odometry on a recording: open, track, write and record, summarise."""

from __future__ import annotations

import logging
import math
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from vo.base.config import Config, MemoryConfig, dump_config
from vo.base.errors import (
    ConfigError,
    NoCalibration,
    NoPairCalibration,
    SourceError,
    VoError,
)
from vo.base.extras import require
from vo.base.geometry.rig_overlap import overlaps
from vo.base.images.image_areas import split_cameras
from vo.base.records.estimated_camera import EstimatedCamera
from vo.base.records.inertial_use import InertialUse
from vo.base.scheduling import one_opencv_thread
from vo.engine.rig.creation import check_has_map, is_tracked_as_rig, make_odometry
from vo.engine.stages import Components
from vo.engine.trajectory.interpolation import InterpolatedFrames
from vo.outputs.recorders.exports import Exports, with_exports
from vo.outputs.recorders.recorder import NullRecorder, Recorder
from vo.outputs.results.folder import RESULTS, RunFolder, RunSpace
from vo.outputs.results.output_paths import (
    locked_folder,
    refuse_to_collide,
    refuse_to_overwrite,
)
from vo.outputs.results.summary import Summary
from vo.outputs.streaming.streams import PoseStreams, opened_streams
from vo.recordings.formats.warning_kinds import collected_warnings
from vo.recordings.sources.imu import usable_noise
from vo.recordings.sources.live.address import LiveAddress, parse_address
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.sequence import ImageSequence
from vo.recordings.sources.source import FrameStream, LiveStream, Recording
from vo.runs.camera_poses import save_calibration
from vo.runs.inertial_checks import Unusable, why_unusable
from vo.runs.readout import checked_readout
from vo.runs.run_options import RunOptions
from vo.runs.run_session import OpenedRun, RunSession
from vo.runs.scaling.scale_sources import make_scale_sources
from vo.runs.second_pass import (
    FocalLengthChange,
    InertialContradiction,
    TrackAgain,
    WrongCalibration,
    exchanged,
    known_at_first,
)

_log = logging.getLogger(__name__)
_ALIKE = 0.5  # cosine of the angle between cameras that look the same way


def run(
    source: str | Path | FrameStream,
    output: Path,
    *,
    config: Config,
    **given: Any,
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
        **given: see `RunOptions`.

    Raises:
        SourceError: the recording is missing, damaged, or has no readable frame.
        CalibrationError: its calibration is missing or implausible.
        ConfigError: `tracking.every` is above 1 for a stream, or a log that is followed; a mask
            cannot be used; an option is unknown or of a wrong type.
        OutputError: the folder or the recording cannot be written, another run is writing there,
            it holds files of others with names of a run's, two outputs are the same file or
            one is an input, the map is of another camera and cannot be saved, no viewer answers,
            or poses cannot be sent.
        KeyboardInterrupt: a stop signal came before the last frame, or the reader of the poses on
            standard output is gone.
    """
    options = RunOptions.of(given)
    _check_outputs(source, output, config, options)
    with collected_warnings(are_shown=True) as warnings:
        stream, camera = _open_or_estimate(source, config, options)
        config = checked_readout(stream, config, options)
        opened = _opened(source, stream, config, options)
        if config.camera.focal == "slow":
            zoomed = _followed(opened)
            opened = replace(_opened(source, zoomed.stream, config, options), known=zoomed.known)
        opened, components = _with_imu(opened)
    opened = replace(opened, warnings=tuple(warnings), estimated_camera=camera)
    with (
        _disconnected_at_end(stream),
        opened_streams(options.poses, options.allow_origins) as poses,
        locked_folder(Path(output)),
        one_opencv_thread(),
    ):
        while True:
            try:
                return _run(opened, output, components, poses)
            except TrackAgain as found:  # all files are made anew
                _log.info("%s; all frames are tracked again", found)
                reason = found.with_traceback(None)
            opened = _followed(opened) if isinstance(reason, FocalLengthChange) else opened
            again = _opened(source, opened.stream, config, options)
            opened, components = _again(reason, opened, again, components)


def _followed(opened: OpenedRun) -> OpenedRun:
    """The recording with images at a constant focal length."""
    if not opened.known.can_follow:
        raise ConfigError("`camera.focal=slow` needs a recording of one or two cameras to its end")
    from vo.runs.zoom import follow_focal_length  # seldom needed

    stream, focal = follow_focal_length(opened.stream, opened.config, opened.options)
    known = opened.known._replace(can_follow=False, focal_lengths=focal)
    return replace(opened, stream=stream, known=known)


def _again(
    reason: TrackAgain, before: OpenedRun, opened: OpenedRun, components: Components
) -> tuple[OpenedRun, Components]:
    """The recording opened anew, and the components, for another pass."""
    unused, known = before.unused_imu, reason.known_after(before.known)
    camera, warnings = before.estimated_camera, before.warnings
    components = components._replace(k1_error=known.k1_error)
    if isinstance(reason, InertialContradiction):
        unused = replace(reason.use, states=None, first_frame=None, metric_worlds=())
        components = components._replace(inertial_sensor=None)
    if isinstance(reason, WrongCalibration):
        camera, warnings = reason.found, (*warnings, reason.warning)
    opened = replace(opened, unused_imu=unused, known=known, estimated_camera=camera)
    return replace(opened, warnings=warnings), components


def _run(opened: OpenedRun, output: Path, components: Components, poses: PoseStreams) -> Summary:
    """One run over all frames; raises as `run` and `RunSession.run` do."""
    stream, config, options = opened.stream, opened.config, opened.options
    every, is_live = config.tracking.every, isinstance(stream, LiveStream)
    frames = stream.frames(options.start, options.end, options.stride * every)
    rig = stream.rig
    if opened.known.is_exchanged:
        frames, rig = exchanged(frames), rig.exchanged()
    decided = _with_loops(config, options, is_live)
    is_metric = stream.rig.is_stereo or stream.rig.has_depth
    if not (is_live or is_metric) and components.inertial_sensor is None:
        decided = _with_rescue(decided, components)
    if options.save_map is not None:
        check_has_map(rig, decided, "save_map")
    with closing(make_odometry(rig, decided, components)) as odometry:
        if options.save_map is not None:
            odometry.map_alignment.check_savable(options.save_map)
        if every > 1 and isinstance(stream, Recording):
            interpolated = InterpolatedFrames(stream.stamps_ns, options.stride, every)
            odometry.trajectory.interpolated = interpolated
        exports = options.exports or Exports()
        recorder = with_exports(_recorder(options, is_live=is_live), exports, may_drop=is_live)
        # rerun and MCAP accept no other bytes
        name = stream.name.encode("utf-8", "replace").decode()
        with closing(RunSpace(Path(output), opened.facts().requested)) as space:
            recorder.begin(name, stream.rig, stream.ground_truth)
            # Last: it clears an earlier run.
            folder = RunFolder(Path(output), dump_config(config), space)
            camera, file = opened.estimated_camera, options.save_calibration
            save_calibration(folder.path, stream, stream.rig, camera, file)
            summary = RunSession(opened, odometry, folder, recorder, poses).run(frames)
            if odometry.calibration_errors.cameras:
                corrected = odometry.corrected(stream.rig)
                save_calibration(folder.path, stream, corrected, camera, file)
            return summary


def _with_loops(config: Config, options: RunOptions, is_live: bool) -> Config:
    """The settings with `memory.loops` decided, if it is `auto`."""
    memory = config.memory
    if memory.loops != "auto":
        return config
    is_wanted = memory.map != "" or options.save_map is not None
    loops = is_wanted or (config.features.is_orb and not is_live)
    return config.model_copy(update={"memory": memory.model_copy(update={"loops": loops})})


def check_maps(memory: MemoryConfig, *, saves: bool) -> None:
    """Refuse what contradicts itself among the options of maps; raises `ConfigError`."""
    if saves and not memory.loops:
        raise ConfigError("`save_map` needs loops; leave out `memory.loops=false`")
    if memory.map and not memory.loops:
        raise ConfigError("`memory.map` needs loops; leave out `memory.loops=false`")
    if memory.localize and not memory.map:
        raise ConfigError("`memory.localize` finds poses in a map; give it by `memory.map=FILE`")
    if memory.localize and saves:
        raise ConfigError("`memory.localize` adds nothing to the map; leave out `save_map`")


def _with_rescue(config: Config, components: Components) -> Config:
    """The settings with `features.rescue` decided, if it is `auto`, by what is installed."""
    features, method = config.features, config.matching.method
    is_exchanged = components.extractor is not None or components.matcher is not None
    is_usual = features.is_orb and method == "auto" and config.tracking.method == "patches"
    if features.rescue != "auto" or is_exchanged or not is_usual:
        return config
    from vo.engine.learned.files import model_file

    try:
        if not model_file("xfeat").is_file():
            return config
    except RuntimeError:  # there is no home
        return config
    rescued = features.model_copy(update={"rescue": "xfeat"})
    return config.model_copy(update={"features": rescued})


def _check_outputs(
    source: str | Path | FrameStream, output: Path, config: Config, options: RunOptions
) -> None:
    """Refuse outputs that would overwrite the input, files of others, or each other."""
    if options.rrd is not None or options.viewer is not None:
        require("rerun", "view", "recordings for the viewer")
    memory = config.memory
    check_maps(memory, saves=options.save_map is not None)
    path = Path(source) if isinstance(source, str | Path) else None
    exports, save_map = options.exports or Exports(), options.save_map
    files = (options.rrd, *exports.files.values(), options.record, options.save_calibration)
    masks = [Path(split_cameras(text)[1]) for text in config.masks.files]
    vocabulary = Path(memory.vocabulary) if memory.vocabulary else None
    inputs = (path, options.calibration, vocabulary, *masks)
    refuse_to_overwrite(inputs, (Path(output), *files, save_map))
    results = [Path(output) / name for name in RESULTS]  # also a markers.csv of an earlier run
    refuse_to_overwrite([options.scale.marker_map], (*files, save_map, *results))
    # Only the new map may replace the old one.
    refuse_to_overwrite([Path(memory.map) if memory.map else None], (Path(output), *files))
    refuse_to_collide(Path(output), (*files, save_map))


def _open_or_estimate(
    source: str | Path | FrameStream, config: Config, options: RunOptions
) -> tuple[FrameStream, EstimatedCamera | None]:
    """The stream, and its camera if that had to be estimated from its images."""
    try:
        return _open(source, config, options), None
    except NoCalibration as missing:
        if options.mode == "stereo" or options.follow or options.side_by_side:
            raise
        from vo.runs.camera_estimation import open_estimated

        return open_estimated(str(source), config, options, missing)
    except NoPairCalibration as missing:
        if config.camera.baseline_m is None or options.follow:
            raise
        from vo.runs.pair_estimation import open_estimated_pair

        return open_estimated_pair(str(source), config, options, missing)


def _open(source: str | Path | FrameStream, config: Config, options: RunOptions) -> FrameStream:
    every = config.tracking.every
    if every > 1 and (options.follow or not isinstance(source, str | Path | Recording)):
        what = "a log that is followed" if options.follow else "a stream"
        raise ConfigError(f"tracking.every is {every}; {what} needs 1")
    if not isinstance(source, str | Path):
        return source
    address = parse_address(str(source))
    if address is not None:
        return _open_live(address, config, options)
    for option in ("timeout_s", "duration_s", "record"):
        if getattr(options, option) is not None:
            raise SourceError(f"`{option}` is for live sources, and {source} is a recording")
    opened = open_source(source, mode=options.mode, **_reading(options))
    are_alike = bool((opened.rig.cam0_from_cams[:, 2, 2] > _ALIKE).all())
    sensor = next(iter(opened.imus), None) if config.inertial.enabled else None
    is_placed = sensor is not None and sensor.cam0_from_imu is not None
    is_usable = are_alike or not is_placed or not _has_late_cameras(opened)
    if options.mode != "auto" or is_usable or overlaps(opened.rig):
        return opened
    _log.warning(
        "%s: its %d cameras see nothing in common, at different times; only cam0 and the inertial "
        "sensor are used, for metres (`inertial.enabled=false`: all cameras, without it)",
        opened.name,
        len(opened.rig.cameras),
    )
    return open_source(source, mode="mono", **_reading(options))


def _has_late_cameras(stream: FrameStream) -> bool:
    """Whether images of a frame have different times, which blurs the motions of a rig."""
    return isinstance(stream, ImageSequence) and stream.image_stamps_ns is not None


def _reading(options: RunOptions) -> dict[str, Any]:
    """How a recording is opened, but for the mode."""
    names = ("format", "calibration", "topics", "follow", "right_offset_ns", "side_by_side")
    return {name: getattr(options, name) for name in names}


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
        if getattr(options, option) not in (None, False, (), []):
            raise SourceError(f"`{option}` is for recordings, and {name} is a live source")
    timeout_s, duration_s = options.timeout_s, options.duration_s
    live = LiveOptions(
        options.side_by_side,
        DEFAULT_TIMEOUT_S if timeout_s is None else timeout_s,
        math.inf if duration_s is None else duration_s,
        options.allow_hosts,
    )
    stream = open_live(address, options.calibration, options.mode, live)
    if options.record is not None:
        from vo.outputs.recorders.frame_log import FrameLog  # protobuf takes long to import

        try:
            stream.tap = FrameLog(options.record, stream.rig)
        except VoError:
            stream.close()
            raise
    return stream


def _with_imu(opened: OpenedRun) -> tuple[OpenedRun, Components]:
    """The parts of the odometry with the inertial sensor, or the run with why it is not used."""
    stream, components = opened.stream, opened.options.components
    if not opened.config.inertial.enabled or components.inertial_sensor is not None:
        return opened, components
    if opened.options.follow or not isinstance(stream, Recording) or not stream.imus:
        return opened, components
    sensor = stream.imus[0]
    others = [each for each in opened.scale.all if each is not opened.scale.wheel]
    reason = ""
    if others and not stream.rig.is_metric:
        reason = "it cannot be combined with another source of the scale"
    elif _has_late_cameras(stream) and is_tracked_as_rig(stream.rig, opened.config):
        reason = "the images of the rig have different times"
    if reason:
        return replace(opened, unused_imu=InertialUse(sensor.name, reason)), components
    try:
        unusable = why_unusable(sensor, stream.stamps_ns)
    except SourceError as error:
        unusable = Unusable(str(error))
    if unusable is not None:
        unused = InertialUse(sensor.name, unusable.reason, unusable.is_error)
        return replace(opened, unused_imu=unused), components
    noise = usable_noise(sensor)
    return opened, components._replace(inertial_sensor=sensor, inertial_noise=noise)


def _disconnected_at_end(stream: FrameStream) -> AbstractContextManager[object]:
    return closing(stream) if isinstance(stream, LiveStream) else nullcontext()


def _opened(
    source: str | Path | FrameStream, stream: FrameStream, config: Config, options: RunOptions
) -> OpenedRun:
    path = stream.name
    if isinstance(source, str | Path) and not isinstance(stream, LiveStream):
        path = str(Path(source))
    recording = path if isinstance(source, str | Path) else None
    given = options.scale if options.gps is None else replace(options.scale, gps=options.gps)
    scale = make_scale_sources(given, options.scale_sources, stream, recording, options.topics)
    name, known = options.source_name or path, known_at_first(stream, config, options)
    return OpenedRun(stream, path, name, config, options, scale, known=known)


def _recorder(options: RunOptions, *, is_live: bool) -> Recorder:
    if options.recorder is not None:
        return options.recorder
    if options.rrd is None and options.viewer is None:
        return NullRecorder()
    from vo.outputs.recorders.background import BackgroundRecorder
    from vo.outputs.recorders.rerun_recorder import RerunRecorder  # importing rerun takes long

    recorder = RerunRecorder(options.rrd, images=options.rrd_images, viewer=options.viewer)
    return BackgroundRecorder(recorder, may_drop=options.viewer is not None or is_live)
