"""Odometry for a program of one's own, frame by frame, as fast as they come."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from vo.api.inputs import FrameInput, config_of, rig_of
from vo.api.same_bits import prepare
from vo.base.config import Config
from vo.base.errors import VoError
from vo.base.images.given_images import ColourOrder
from vo.base.records.calibration_errors import CalibrationErrors
from vo.base.types import Estimate, KeyframePose, Mode, Rig, Snapshot, Trajectory
from vo.engine.odometry import Odometry as FrameOdometry
from vo.engine.stages import BUILT_IN, Components
from vo.outputs.results.run_statistics import RunStatistics
from vo.outputs.results.summary import RunFacts, Summary
from vo.recordings.formats.calibration import Calibration
from vo.runs.run_summary import summarise_odometry


class Odometry:
    """Computes the pose of each frame as it comes: `with vo.Odometry(...) as odometry: ...`.

    `track` returns when the pose is known; the map is extended in a thread until the next call. The
    same frames give the same bits as `vo run`, however fast they come. The constructor compiles the
    inner loops if that was not done before (10 to 20 s, once; `vo warmup` does it beforehand).

    Calls from several threads wait for each other.

    Args:
        calibration: the cameras: a file in any supported format, `vo.read_calibration(file)`, the
            `rig` of `vo.open(recording)`, or a `vo.Rig`.
        config: `default`, `fast`, `accurate`, a YAML file like configs/default.yaml, or a
            `vo.Config`.
        mode: `mono` leaves the right camera out, `stereo` requires it, `auto` takes what there is.
        has_depth: whether there will be depth images of camera 0.
        colour: order of the channels of colour images, `bgr` as in OpenCV, or `rgb`.
        overrides: settings to change, such as `["features.count=2500"]`.
        components: parts to be used instead of the built-in ones.

    Raises:
        CalibrationError: the calibration cannot be read, or the cameras cannot be rectified.
        ConfigError: a setting or an argument is invalid.
    """

    def __init__(
        self,
        calibration: Calibration | Rig | str | Path,
        config: Config | str | Path = "default",
        *,
        mode: Mode = "auto",
        has_depth: bool = False,
        colour: ColourOrder = "bgr",
        overrides: Sequence[str] = (),
        components: Components = BUILT_IN,
    ) -> None:
        self.rig = rig_of(calibration, mode, has_depth=has_depth)
        self._config = config_of(config, overrides)
        self._input = FrameInput(self.rig, colour)
        prepare()
        self._odometry = FrameOdometry(self.rig, self._config, components)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="map")
        self._update: Future[None] | None = None  # extension of the map by the newest frame
        self._lock = threading.Lock()
        self._statistics = RunStatistics()
        self._unpaired = 0
        self._begun = time.perf_counter()
        self._end = ""  # why no further frame is taken

    def track(
        self, stamp_ns: int, left: Any, right: Any = None, depth: Any = None, mask: Any = None
    ) -> Estimate:
        """The pose of the next frame.

        Images are copied; they are given as recorded, neither undistorted nor rectified.

        Args:
            stamp_ns: time of the frame in integer nanoseconds, above that of the frame before.
            left: image of camera 0: (H, W) in grey or (H, W, 3 or 4) in colour, uint8 or uint16.
            right: image of camera 1 at the same time, None if it is missing.
            depth: (H, W) of camera 0, as float metres or uint16 millimetres; 0, negative and NaN
                where unknown.
            mask: (H, W) bool or uint8, nonzero where the left image may be used, beside the masks
                of all frames (section `masks` of the settings).

        Raises:
            InputError: a value is of the wrong type, shape, size or order; the next call goes on.
            VoError: the odometry is closed, or has failed before.
        """
        with self._lock:
            self._check_open()
            frame = self._input.frame(stamp_ns, left, right, depth, mask)
            try:
                self._finish_update()
                estimate = self._odometry.locate(frame)
                self._update = self._worker.submit(self._odometry.update_map)
            except BaseException as error:
                self._end = f"an earlier call failed ({type(error).__name__})"
                raise
            self._count(estimate, is_unpaired=self._lacks_partner(right, depth))
            return estimate

    def trajectory(self) -> Trajectory:
        """The smoothed path so far, as in `trajectory.tum`; final after `close`."""
        with self._lock:
            self._finish_update()
            return self._odometry.trajectory.trajectory()

    def keyframes(self) -> list[KeyframePose]:
        """All keyframes so far, with their covariances."""
        with self._lock:
            self._finish_update()
            return list(self._odometry.trajectory.keyframes())

    def snapshot(self) -> Snapshot:
        """The newest frame and the local map, for display.

        Raises:
            VoError: the odometry is closed, or no frame has been tracked yet.
        """
        with self._lock:
            self._check_open()
            self._finish_update()
            if not self._statistics.frames:
                raise VoError("no frame has been tracked yet")
            return self._odometry.snapshot()

    @property
    def calibration_errors(self) -> CalibrationErrors:
        """Errors of the calibration that were found and are corrected."""
        with self._lock:
            self._finish_update()
            return self._odometry.calibration_errors

    def summary(self) -> Summary:
        """What `vo run` would print so far: verdict, warnings, figures."""
        with self._lock:
            self._finish_update()
            return summarise_odometry(
                self._odometry,
                self._facts(),
                "finished",
                self._statistics,
                unpaired=self._unpaired,
                wall_s=time.perf_counter() - self._begun,
            )

    def close(self) -> None:
        """Optimise the newest keyframes, and end threads and processes; results stay available."""
        with self._lock:
            if self._end == "it is closed":
                return
            try:
                if not self._end:
                    self._finish_update()
                    self._odometry.finish()
            finally:
                self._end = "it is closed"
                self._worker.shutdown()
                self._update = None
                self._odometry.close()

    def __enter__(self) -> Self:
        """The odometry itself; it is closed at the end of `with`."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._end:
            raise VoError(f"this odometry takes no more frames: {self._end}; create another one")

    def _finish_update(self) -> None:
        """Wait until the map has been extended by the newest frame."""
        update, self._update = self._update, None
        if update is not None:
            update.result()

    def _lacks_partner(self, right: Any, depth: Any) -> bool:
        return (self.rig.is_stereo and right is None) or (self.rig.has_depth and depth is None)

    def _count(self, estimate: Estimate, *, is_unpaired: bool) -> None:
        self._statistics.add(estimate)
        self._statistics.add_times(estimate.stage_ms)
        self._unpaired += is_unpaired

    def _facts(self) -> RunFacts:
        frames = len(self._statistics.frames)
        return RunFacts(
            source="frames of a program",
            format="library",
            mode="rgbd" if self.rig.has_depth else "stereo" if self.rig.is_stereo else "mono",
            has_ground_truth=False,
            seed=self._config.seed,
            start=0,
            end=frames,
            stride=1,
            requested=frames,
        )
