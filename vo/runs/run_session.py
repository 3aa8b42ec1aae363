"""A run from its first frame to its last."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import replace

from vo.base.config import Config
from vo.base.errors import OutputError, SourceError
from vo.base.faults import Fault
from vo.base.frozen import frozen
from vo.base.option_names import with_flags
from vo.base.printable import one_line
from vo.base.records.estimated_camera import EstimatedCamera
from vo.base.records.inertial_use import InertialUse
from vo.base.stopwatch import Stopwatch
from vo.base.types import Estimate, Frame, Trajectory
from vo.engine.rig.creation import AnyOdometry, scale_sources
from vo.outputs.recorders.recorder import LoopClosures, Recorder
from vo.outputs.results.folder import RunFolder
from vo.outputs.results.live_summary import LiveState
from vo.outputs.results.run_statistics import Profile, RunStatistics, make_profile
from vo.outputs.results.summary import RunFacts, Status, Summary, mode_of
from vo.outputs.results.tables import covariance_line, frame_line, pose_lines
from vo.outputs.streaming.streams import PoseStreams
from vo.recordings.formats.trajectory import fields_of_poses, tum_line, tum_line_of_fields
from vo.recordings.formats.warning_kinds import LoggedWarning
from vo.recordings.sources.source import FrameStream, LiveStream, Recording
from vo.runs.camera_poses import write_camera_poses
from vo.runs.inertial_checks import contradiction_faults
from vo.runs.interrupts import DeferredInterrupts, deferred_interrupts
from vo.runs.pose_log import PoseLog
from vo.runs.progress import NullProgress, Progress
from vo.runs.run_options import RunOptions
from vo.runs.run_scale import RunScale
from vo.runs.run_summary import summarise_odometry
from vo.runs.scaling.scale_sources import ScaleSources
from vo.runs.second_pass import Known, TrackAgain, check_sensor, watched, zoom_faults

_log = logging.getLogger(__name__)
_REFRESH_S = 3.0  # minimum time between interim summaries
_REFRESH_RATIO = 0.02  # maximum ratio of the time that they take


@frozen()
class OpenedRun:
    """A recording that was opened for a run.

    Attributes:
        stream: its frames.
        path: its path, or the name of a stream.
        public_name: its name in summaries and messages.
        config: all settings; `options` are those of the run.
        scale: what measures the scale of a mono path, and places it on the globe.
        unused_imu: the inertial sensor, if it cannot be used.
    """

    stream: FrameStream
    path: str
    public_name: str
    config: Config
    options: RunOptions
    scale: ScaleSources = ScaleSources()
    unused_imu: InertialUse | None = None
    known: Known = Known()  # by an earlier pass
    warnings: tuple[LoggedWarning, ...] = ()  # of opening
    estimated_camera: EstimatedCamera | None = None  # without a calibration

    def facts(self) -> RunFacts:
        """Facts about the run; a stream without length has no known number of frames."""
        stream, options = self.stream, self.options
        end = options.end or 0
        if isinstance(stream, Recording):
            length = len(stream)
            end = length if options.end is None else min(options.end, length)
        rig = stream.rig
        return RunFacts(
            source=self.public_name,
            format=stream.format,
            mode=mode_of(rig),
            has_ground_truth=stream.ground_truth is not None,
            seed=self.config.seed,
            start=options.start,
            end=end,
            stride=options.stride,
            requested=len(range(options.start, end, options.stride)) if options.stride else 0,
            every=self.config.tracking.every,
            calibration=None if options.calibration is None else str(options.calibration),
            topics=tuple(options.topics),
            right_offset_ns=options.right_offset_ns,
            opening_warnings=tuple(
                each._replace(text=self.with_public_name(each.text))
                for each in self.warnings
                if rig.is_stereo or each.kind != "large_baseline"
            ),
            estimated_camera=self.estimated_camera,
            focal_lengths=self.known.focal_lengths,
        )

    def with_public_name(self, text: str) -> str:
        """A message with the public name in place of the path."""
        return text if self.path == self.public_name else text.replace(self.path, self.public_name)


class RunSession:
    """Tracks the frames of a run, writes results, records, and summarises."""

    def __init__(
        self,
        opened: OpenedRun,
        odometry: AnyOdometry,
        folder: RunFolder,
        recorder: Recorder,
        poses: PoseStreams,
    ) -> None:
        self._stream = stream = opened.stream
        self._opened, self._options = opened, opened.options
        self._facts = opened.facts()
        self._odometry = odometry
        self._folder = folder
        self._recorder = recorder
        self._progress: Progress = opened.options.progress or NullProgress()
        self._poses = poses
        is_live = isinstance(stream, LiveStream)
        poses.begin(is_metric=stream.rig.is_metric, faults=stream.faults, is_live=is_live)
        self._statistics = RunStatistics()
        self._statistics.faults.add(stream.faults)
        handled = contradiction_faults(opened.unused_imu, is_handled=True)
        self._statistics.faults.add((*handled, *zoom_faults(opened.known.focal_lengths)))
        self._causal = PoseLog()
        self._begun = self._refreshed = time.perf_counter()
        self._refresh_took = self._start_up_ms = 0.0
        self._scale = RunScale(opened.scale, scale_sources(odometry))
        self._is_warned = False  # that results are incomplete

    def run(self, frames: Iterator[Frame]) -> Summary:
        """Track all frames, and save the results however the run ends.

        Raises:
            SourceError: no frame could be read.
            OutputError: a file cannot be written.
            KeyboardInterrupt: a stop signal came before the last frame.
            TrackAgain: a run without what was found to be wrong is to replace the results.
        """
        with deferred_interrupts() as interrupts, closing(self._folder):
            try:
                self._begin()
                self._track(frames, interrupts)
                interrupts.close()
                return self._end()
            except BaseException as error:
                interrupts.close()
                self._end_early(error)
                raise

    def _begin(self) -> None:
        """Start the progress; write a summary that holds if the process is killed from here on."""
        self._summarise("interrupted")
        self._progress.begin(self._stream.name, self._facts.requested)

    def _track(self, frames: Iterator[Frame], interrupts: DeferredInterrupts) -> None:
        """Track all frames; stop signals are delivered between them."""
        clock = Stopwatch()
        since = self._options.profile_since
        self._start_up_ms = 0.0 if since is None else (time.perf_counter() - since) * 1e3
        for estimate in self._estimates(_awaited(frames, clock, interrupts), interrupts):
            with clock.stage("write"), interrupts.waiting(signals=1):
                is_metric = self._odometry.trajectory.metric.is_metric(estimate.segment)
                self._poses.send(estimate, is_metric=is_metric)
            self._output(estimate, clock)
            self._folder.frames.append(frame_line(estimate, clock.stage_ms))
            self._statistics.add_times(clock.stage_ms)
            clock.stage_ms.clear()
            self._refresh_if_due()
            if not self._is_last(estimate):  # a signal in the last frame does not stop the run
                interrupts.check()
                self._poses.check()
        if not self._statistics.frames:
            raise _nothing_readable(self._stream)

    def _estimates(
        self, frames: Iterator[Frame], interrupts: DeferredInterrupts
    ) -> Iterator[Estimate]:
        """The results of all frames; those of a live stream at once, without reading ahead."""
        stream = self._stream
        if not isinstance(stream, LiveStream):
            yield from watched(self._odometry, frames, self._opened)
            return
        interrupts.end_gently(stream.stop)
        for frame in frames:
            estimate = replace(self._odometry.locate(frame), dropped=stream.dropped)
            self._statistics.add_delay(1e-6 * (stream.now_ns() - frame.stamp_ns))
            yield estimate
            self._odometry.update_map()

    def _end(self) -> Summary:
        """Finish the files and the recording after the last frame, and summarise."""
        self._end_progress()
        self._statistics.add_times(self._odometry.finish())
        check_sensor(self._odometry.map_alignment.inertial, self._opened.known)
        self._statistics.faults.add(self._contradiction())
        clock = Stopwatch()
        with clock.stage("write"):
            self._apply_scale()
            self._finish_files()
            if self._options.save_map is not None:
                self._summarise("interrupted")  # of the frames of the tables, if it is killed now
                self._save_map()
            self._summarise("finished")  # the path is complete, whatever happens to recordings
        with clock.stage("record"):
            self._finish_recording()
        self._statistics.add_times(clock.stage_ms)
        return self._summarise("finished")

    def _contradiction(self) -> list[Fault]:
        return contradiction_faults(self._odometry.map_alignment.inertial, is_handled=False)

    def _end_early(self, error: BaseException) -> None:
        """Save the results so far before an error is raised again."""
        self._end_progress()
        if isinstance(error, TrackAgain):
            return self._save(self._finish_recording)
        status: Status = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
        reason = None if status == "interrupted" else _one_line(error)
        # A full disk is one error, however many files it concerns.
        self._is_warned = isinstance(error, OutputError)
        if status == "interrupted":
            self._save(self._odometry.finish)  # fails if a frame was broken off
            self._statistics.faults.add(self._contradiction())
        self._save(self._apply_scale)
        self._save(self._finish_files)
        self._save(lambda: self._summarise(status, reason))
        if status == "interrupted":
            self._save(self._save_map)
        self._save(self._finish_recording)
        if status == "failed" and self._statistics.frames and not self._is_warned:
            frames, path = len(self._statistics.frames), self._folder.path
            _log.warning("the run failed after %d frames; what they gave is in %s", frames, path)

    def _end_progress(self) -> None:
        with suppress(OSError):  # the terminal was closed
            self._progress.finish()

    def _save(self, part: Callable[[], object]) -> None:
        """Save one part; an error, such as a full disk, does not affect the others."""
        try:
            part()
        except Exception as error:
            if not self._is_warned:
                reason = str(error) if isinstance(error, OutputError) else _one_line(error)
                _log.warning("results are incomplete: %s", reason)
            self._is_warned = True

    def _is_last(self, estimate: Estimate) -> bool:
        """Whether no frame of a recording is left after this one."""
        facts, is_known = self._facts, not self._options.follow and self._facts.requested > 0
        return is_known and estimate.frame_index + facts.stride * facts.every >= facts.end

    def _finish_files(self) -> None:
        try:
            if not self._folder.is_finished:
                self._write_changed()
                write_camera_poses(self._folder.path, self._odometry, self._stream)
                if self._odometry.map_alignment.closed_loops:
                    self._folder.write_odometry(self._before_loops(in_metres=True))
        finally:
            self._folder.finish()

    def _save_map(self) -> None:
        if self._options.save_map is not None:
            self._odometry.map_alignment.save_map(self._options.save_map, self._opened.public_name)

    def _apply_scale(self) -> None:
        self._scale.apply(
            self._odometry.trajectory, self._folder.path, self._odometry.map_alignment
        )

    def _finish_recording(self) -> None:
        map_alignment, store = self._odometry.map_alignment, self._odometry.trajectory
        closures = None
        if map_alignment.closed_loops:
            found = (
                map_alignment.closed_loops,
                map_alignment.relocalisations,
                self._before_loops(in_metres=False),
            )
            scales = store.map_scales()
            closures = LoopClosures(*found, store.worlds, scales)
        self._scale.finish(self._recorder, self._causal.trajectory(), store, closures)

    def _before_loops(self, *, in_metres: bool) -> Trajectory:
        store = self._odometry.trajectory
        return self._odometry.map_alignment.path_before_loops(store, in_metres=in_metres)

    def _output(self, estimate: Estimate, clock: Stopwatch) -> None:
        self._statistics.add(estimate)
        clock.stage_ms.update(estimate.stage_ms)
        with clock.stage("write"):
            self._write(estimate)
        self._scale.observe(estimate, self._odometry.snapshot)
        self._odometry.map_alignment.see_markers(
            estimate.frame_index, *self._scale.newest_markers()
        )
        with clock.stage("record"):
            self._recorder.record(estimate, self._odometry.snapshot)
        done = (estimate.frame_index - self._facts.start) // self._facts.stride + 1
        self._progress.step(done, estimate)

    def _write(self, estimate: Estimate) -> None:
        """Append a frame, and rewrite the poses that optimisation has moved."""
        if estimate.world_from_cam0 is not None:
            self._causal.append(estimate.stamp_ns, estimate.world_from_cam0)
        if estimate.causal_pose is not None:
            self._folder.causal.append(tum_line(estimate.stamp_ns, estimate.causal_pose))
        self._write_changed()

    def _write_changed(self) -> None:
        trajectory = self._odometry.trajectory
        row, keyframe_row = trajectory.take_changes()
        path = trajectory.path(row)
        fields = fields_of_poses(path.trajectory.world_from_cam)
        stamps_ns = path.trajectory.stamps_ns.tolist()
        self._folder.trajectory.replace_from(row, map(tum_line_of_fields, stamps_ns, fields))
        self._folder.poses.replace_from(row, pose_lines(path, fields))
        keyframes = trajectory.covariances(keyframe_row)
        self._folder.covariance.replace_from(keyframe_row, map(covariance_line, keyframes))

    def _refresh_if_due(self) -> None:
        """Update the summary every few seconds, less often if that takes long."""
        now = time.perf_counter()
        if now - self._refreshed < max(_REFRESH_S, self._refresh_took / _REFRESH_RATIO):
            return
        self._summarise("interrupted")
        self._refreshed = time.perf_counter()
        self._refresh_took = self._refreshed - now

    def _summarise(self, status: Status, error: str | None = None) -> Summary:
        self._facts = self._opened.facts()  # a growing log has more frames now
        named = self._opened.with_public_name
        summary = summarise_odometry(
            self._odometry,
            self._facts,
            status,
            self._statistics,
            skipped=[replace(s, reason=named(s.reason)) for s in self._stream.skipped],
            unpaired=self._stream.unpaired,
            wall_s=time.perf_counter() - self._begun,
            error=None if error is None else named(error),
            profile=self._profile(),
            live=self._live_state(),
            scale=self._scale.findings,
            inertial=self._odometry.map_alignment.inertial or self._opened.unused_imu,
        )
        record, flags = summary.to_dict(), self._options.flags
        record["warnings"] = [with_flags(text, flags) for text in record["warnings"]]
        record |= {} if summary.error is None else {"error": with_flags(summary.error, flags)}
        self._folder.write_summary(record)
        return summary

    def _live_state(self) -> LiveState | None:
        """Drops and gaps of a live stream until now."""
        stream = self._stream
        if not isinstance(stream, LiveStream):
            return None
        return LiveState(stream.dropped, tuple(stream.gaps), stream.unrecorded)

    def _profile(self) -> Profile | None:
        """Profile of the run until now."""
        if (since := self._options.profile_since) is None:
            return None
        wall_ms = (time.perf_counter() - since) * 1e3
        return make_profile(wall_ms, {"start-up": self._start_up_ms, **self._statistics.total_ms()})


def _awaited(
    frames: Iterator[Frame], clock: Stopwatch, interrupts: DeferredInterrupts
) -> Iterator[Frame]:
    """The same frames; the time to read them counts towards stage `read`."""
    while True:
        with clock.stage("read"), interrupts.waiting():
            frame = next(frames, None)
        if frame is None:
            return
        yield frame


def _nothing_readable(stream: FrameStream) -> SourceError:
    if not stream.skipped:
        return SourceError(f"{stream.name}: it ended before the first frame")
    count, first = len(stream.skipped), stream.skipped[0].reason
    return SourceError(
        f"{stream.name}: none of the {count} requested frames can be read; the first: {first}"
    )


def _one_line(error: BaseException) -> str:
    return one_line(f"{type(error).__name__}: {error}")
