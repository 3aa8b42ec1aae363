"""A run in its phases: open source and outputs, go through the frames, close, sum up."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from subprocess import Popen

from vo.config import Config, dump_config
from vo.errors import ConfigError, OutputError, SourceError
from vo.formats.trajectory import pose_fields, tum_line, tum_line_of_fields
from vo.interrupts import interrupts_between_frames
from vo.odometry import Odometry
from vo.progress import NullProgress, Progress
from vo.recording.exports import Exports, with_exports
from vo.recording.recorder import ImageChoice, NullRecorder, Recorder
from vo.results.account import Account
from vo.results.claim import claimed, refuse_to_collide, refuse_to_overwrite
from vo.results.covariance import covariance_line
from vo.results.folder import RunFolder
from vo.results.frames import frame_line
from vo.results.poses import pose_lines
from vo.results.profile import Profile, make_profile
from vo.results.summary import RunFacts, Status, Summary, summarise
from vo.sources.registry import open_source
from vo.sources.source import Source
from vo.stopwatch import Stopwatch
from vo.trajectory.pose_log import PoseLog
from vo.trajectory.store import InterpolatedFrames
from vo.types import Estimate, Frame, Mode

_log = logging.getLogger(__name__)
_REFRESH_S = 3.0
_REFRESH_SHARE = 0.02  # of the time goes into interim summaries, however long the run


def run(
    source: str | Path,
    output: Path,
    *,
    config: Config,
    mode: Mode = "auto",
    start: int = 0,
    end: int | None = None,
    stride: int = 1,
    rrd: Path | None = None,
    rrd_images: ImageChoice = "half",
    viewer: str | None = None,
    calibration: Path | None = None,
    format: str | None = None,
    topics: Sequence[str] = (),
    follow: bool = False,
    source_name: str | None = None,
    recorder: Recorder | None = None,
    exports: Exports | None = None,
    progress: Progress | None = None,
    profile_since: float | None = None,
    smoother_process: Popen[bytes] | None = None,
) -> Summary:
    """Compute a camera's path from a recording and write it as it grows.

    However the run ends, the folder holds what was computed until then and a summary that says
    how it ended: Ctrl-C and errors finish the files before they are raised again; of a killed
    run the files keep `.partial` after their names.

    Args:
        source: folder or file of the recording.
        output: folder for the results, described in docs/outputs.md; those of an earlier run in
            it are removed.
        config: all settings.
        mode: `mono` ignores the right camera, `stereo` insists on it.
        start: first frame.
        end: frame to stop before.
        stride: take every so many frames.
        rrd: file to record for the rerun viewer.
        rrd_images: size of the images in it, and of those that are streamed to `viewer`.
        viewer: URL of a rerun viewer to stream to, besides the file or instead.
        calibration: file that overrides the recording's own.
        format: of the recording; by default found out from the path.
        topics: of a log, `left=/a` and `right=/b`, or one name alone; by default found out.
        follow: whether the log is still being written; frames are taken as they come.
        source_name: what the summary calls the recording, instead of by its path.
        recorder: what to record with instead of `rrd` and `viewer`.
        exports: files for other programs.
        progress: what watches the run.
        profile_since: write a profile; it begins at this time of `time.perf_counter`.
        smoother_process: that of the smoother (`vo.backend.launch`), if it was started already.

    Raises:
        SourceError: the recording is missing, damaged, or holds no frame that can be read.
        CalibrationError: its calibration is missing or cannot be true.
        ConfigError: a log that is followed is to be tracked in part.
        OutputError: the folder or the recording cannot be written, another run is writing there,
            it holds files of others with names of a run's, two outputs are the same file or
            one is what is read, or no viewer answers.
    """
    exports = exports or Exports()
    replaced = None if rrd is None or rrd.suffix == ".rrd" else rrd  # no recording is an .rrd
    written = (exports.mcap, exports.ply, replaced)
    refuse_to_overwrite((Path(source), calibration), written, Path(output))
    refuse_to_collide(Path(output), (rrd, exports.mcap, exports.ply, exports.colmap))
    every = config.tracking.every
    if follow and every > 1:
        raise ConfigError(f"tracking.every is {every}; a log that is followed needs 1")
    opened = open_source(
        source, format=format, calibration=calibration, mode=mode, topics=topics, follow=follow
    )
    called = source_name or str(source)
    facts = partial(_facts, opened, called, config, start, end, stride, calibration, topics)
    frames = opened.frames(start, end, stride * every)
    with (
        claimed(Path(output)),
        closing(Odometry(opened.rig, config, optimizer_process=smoother_process)) as odometry,
    ):
        if every > 1:
            odometry.trajectory.interpolated = InterpolatedFrames(opened.stamps_ns, stride, every)
        recorder = recorder or _make_recorder(rrd, rrd_images, viewer)
        recorder = with_exports(recorder, exports)
        name = opened.name.encode("utf-8", "replace").decode()  # rerun and MCAP take no other bytes
        recorder.begin(name, opened.rig, opened.ground_truth)
        folder = RunFolder(Path(output), dump_config(config))  # last: it clears an earlier run
        job = _Run(opened, facts, odometry, folder, recorder, progress or NullProgress())
        job.profile_since = profile_since
        job.names = (str(source), called)
        try:
            job.begin()
            job.go_through(frames)
        except BaseException as error:
            job.end_early(error)
            raise
        return job.end("finished")


class _Run:
    """What lives from the first frame to the last: the odometry, its watchers and the books."""

    def __init__(
        self,
        source: Source,
        facts: Callable[[], RunFacts],
        odometry: Odometry,
        folder: RunFolder,
        recorder: Recorder,
        progress: Progress,
    ) -> None:
        self._source = source
        self._make_facts = facts
        self._facts = facts()
        self._odometry = odometry
        self._folder = folder
        self._recorder = recorder
        self._progress = progress
        self.profile_since: float | None = None
        self.names = "", ""  # the path of the recording, and what it is called instead
        self._account = Account()
        self._causal = PoseLog()
        self._begun = self._refreshed = time.perf_counter()
        self._refresh_took = 0.0
        self._start_up_ms = 0.0

    def begin(self) -> None:
        """Tell everyone; leave a summary that is true if the process is killed from here on."""
        self._summarise("interrupted")
        self._progress.begin(self._source.name, self._facts.requested)

    def go_through(self, frames: Iterator[Frame]) -> None:
        """Take in frame after frame.

        Raises:
            SourceError: not one could be read.
        """
        clock = Stopwatch()
        if self.profile_since is not None:
            self._start_up_ms = (time.perf_counter() - self.profile_since) * 1e3
        with interrupts_between_frames() as check:
            for estimate in self._odometry.track_all(_timed(frames, clock)):
                self._take_in(estimate, clock)
                self._folder.frames.append(frame_line(estimate, clock.stage_ms))
                self._account.note_time(clock.stage_ms)
                clock.stage_ms.clear()
                self._refresh_if_due()
                check()
        if not self._account.frames:
            raise _nothing_readable(self._source)

    def end(self, status: Status, error: str | None = None) -> Summary:
        """Finish files, recording and, last, the summary."""
        self._progress.finish()
        self._account.note_time(self._odometry.finish())
        clock = Stopwatch()
        with clock.stage("write"):
            self._finish_files()
        with clock.stage("record"):
            self._finish_recording()
        self._account.note_time(clock.stage_ms)
        return self._summarise(status, error)

    def end_early(self, error: BaseException) -> None:
        """Save what there is before an error goes its way."""
        status: Status = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
        reason = None if status == "interrupted" else _one_line(error)
        try:
            with interrupts_between_frames():  # people press Ctrl-C twice: that costs no result
                self._progress.finish()
                if status == "interrupted":
                    self._odometry.finish()
                self._save(self._finish_files)
                self._save(lambda: self._summarise(status, reason))
            self._save(self._finish_recording)
        finally:
            self._folder.close()

    def _save(self, part: Callable[[], object]) -> None:
        """One part after the other, so that a full disk does not take the rest along."""
        try:
            part()
        except OutputError as error:
            _log.warning("results are incomplete: %s", error)

    def _finish_files(self) -> None:
        self._write_changed()
        self._folder.finish()

    def _finish_recording(self) -> None:
        self._recorder.finish(self._causal.trajectory(), self._odometry.trajectory.trajectory())

    def _take_in(self, estimate: Estimate, clock: Stopwatch) -> None:
        self._account.note(estimate)
        clock.stage_ms.update(estimate.stage_ms)
        with clock.stage("write"):
            self._write(estimate)
        with clock.stage("record"):
            self._recorder.record(estimate, self._odometry.snapshot)
        done = (estimate.frame_index - self._facts.start) // self._facts.stride + 1
        self._progress.step(done, estimate)

    def _write(self, estimate: Estimate) -> None:
        """Append this frame, and write anew what smoothing has moved."""
        if estimate.world_from_cam0 is not None:
            self._causal.append(estimate.stamp_ns, estimate.world_from_cam0)
            self._folder.causal.append(tum_line(estimate.stamp_ns, estimate.world_from_cam0))
        self._write_changed()

    def _write_changed(self) -> None:
        trajectory = self._odometry.trajectory
        row, keyframe_row = trajectory.take_changes()
        path = trajectory.path(row)
        fields = [pose_fields(pose) for pose in path.trajectory.world_from_cam]
        stamps_ns = path.trajectory.stamps_ns.tolist()
        self._folder.trajectory.replace_from(row, map(tum_line_of_fields, stamps_ns, fields))
        self._folder.poses.replace_from(row, pose_lines(path, fields))
        keyframes = trajectory.keyframes(keyframe_row)
        self._folder.covariance.replace_from(keyframe_row, map(covariance_line, keyframes))

    def _refresh_if_due(self) -> None:
        """Bring the summary up to date every few seconds, less often when that takes long."""
        now = time.perf_counter()
        if now - self._refreshed < max(_REFRESH_S, self._refresh_took / _REFRESH_SHARE):
            return
        self._summarise("interrupted")
        self._refreshed = time.perf_counter()
        self._refresh_took = self._refreshed - now

    def _summarise(self, status: Status, error: str | None = None) -> Summary:
        self._facts = self._make_facts()  # a log that is followed has grown
        summary = summarise(
            self._facts,
            status,
            self._account,
            self._odometry.trajectory.path(),
            keyframes=self._odometry.trajectory.keyframe_count,
            skipped=[replace(s, reason=self._named(s.reason)) for s in self._source.skipped],
            unpaired=self._source.unpaired,
            wall_s=time.perf_counter() - self._begun,
            calibration=self._odometry.calibration_errors,
            error=None if error is None else self._named(error),
            profile=self._profile(),
        )
        self._folder.write_summary(summary.to_dict())
        return summary

    def _named(self, text: str) -> str:
        path, name = self.names
        return text if path == name else text.replace(path, name)

    def _profile(self) -> Profile | None:
        """Up to now; what comes after, such as writing it, is not in it."""
        if self.profile_since is None:
            return None
        wall_ms = (time.perf_counter() - self.profile_since) * 1e3
        return make_profile(wall_ms, {"start-up": self._start_up_ms, **self._account.total_ms()})


def _facts(
    opened: Source,
    called: str,
    config: Config,
    start: int,
    end: int | None,
    stride: int,
    calibration: Path | None,
    topics: Sequence[str],
) -> RunFacts:
    stop = len(opened) if end is None else min(end, len(opened))
    return RunFacts(
        source=called,
        format=opened.format,
        mode="rgbd" if opened.rig.has_depth else "stereo" if opened.rig.is_stereo else "mono",
        has_ground_truth=opened.ground_truth is not None,
        seed=config.seed,
        start=start,
        end=stop,
        stride=stride,
        requested=len(range(start, stop, stride)) if stride else 0,
        every=config.tracking.every,
        calibration=None if calibration is None else str(calibration),
        topics=tuple(topics),
    )


def _make_recorder(rrd: Path | None, images: ImageChoice, viewer: str | None) -> Recorder:
    if rrd is None and viewer is None:
        return NullRecorder()
    from vo.recording.background import BackgroundRecorder
    from vo.recording.rerun_recorder import RerunRecorder  # rerun takes long to import

    return BackgroundRecorder(RerunRecorder(rrd, images=images, viewer=viewer))


def _timed(frames: Iterator[Frame], clock: Stopwatch) -> Iterator[Frame]:
    """The same frames; waiting for them counts as stage `read`."""
    while True:
        with clock.stage("read"):
            frame = next(frames, None)
        if frame is None:
            return
        yield frame


def _nothing_readable(source: Source) -> SourceError:
    reason = f"; the first: {source.skipped[0].reason}" if source.skipped else ""
    return SourceError(
        f"{source.name}: none of the {len(source.skipped)} frames asked for can be read{reason}"
    )


def _one_line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
