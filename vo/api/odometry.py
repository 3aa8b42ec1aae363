"""Odometry for a program of one's own, frame by frame, as fast as they come."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Self, Unpack

from vo.api.inputs import FrameInput, calibration_of, config_of, rig_of, stamp_of
from vo.api.pose_between import pose_between
from vo.api.pushed_imu import PushedImu
from vo.api.run_words import OdometryWords, split_odometry_words
from vo.api.same_bits import prepare
from vo.base.config import Config
from vo.base.errors import VoError
from vo.base.images.given_images import ColourOrder
from vo.base.records.calibration_errors import CalibrationErrors
from vo.base.records.inertial_use import InertialUse
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, KeyframePose, Mode, PredictedPose, Rig, Trajectory
from vo.engine.rig.creation import make_odometry
from vo.engine.stages import BUILT_IN, Components
from vo.outputs.results.output_paths import refuse_to_overwrite
from vo.outputs.results.run_statistics import RunStatistics
from vo.outputs.results.summary import RunFacts, Summary, mode_of
from vo.recordings.formats.calibration import Calibration
from vo.recordings.sources.imu import usable_noise
from vo.runs.inertial_checks import contradiction_faults
from vo.runs.run_recording import check_maps
from vo.runs.run_summary import summarise_odometry

_SOURCE = "frames of a program"


class Odometry:
    """Computes the pose of each frame as it comes: `with vo.Odometry(...) as odometry: ...`.

    `track` returns when the pose is known; the map is extended in a thread until the next call. The
    same frames give the same bits as `vo run`, however fast they come. The constructor compiles the
    inner loops if that was not done before (about 20 s, once; `vo warmup` does it beforehand).

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
        **words: `imu`, `loops`, `map`, `localize`, `save_map`, `vocabulary`, `mask`, `ignore`,
            `roi` and `threads` as in `vo.run`; `imu=True` for samples by `add_imu`, of the sensor
            that the calibration describes, else give a `vo.ImuCalibration`, or one of
            `vo.open(recording).imus`. The map is saved by `close`.

    Raises:
        CalibrationError: the calibration cannot be read, or the cameras cannot be rectified.
        ConfigError: a setting or an argument is invalid.
        OutputError: no map could be saved.
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
        **words: Unpack[OdometryWords],
    ) -> None:
        cameras = calibration_of(calibration)
        self.rig = rig_of(cameras, mode, has_depth=has_depth)
        settings, others = split_odometry_words(words)
        self._config = config_of(config, overrides, settings)
        self._imu = PushedImu.of(others["imu"], cameras)
        if self._imu is not None:
            noise = usable_noise(self._imu)
            components = components._replace(inertial_sensor=self._imu, inertial_noise=noise)
        self._save_map: Path | None = others["save_map"]
        _check_maps(self._config, self._save_map, calibration)
        self._input = FrameInput(self.rig, colour)
        prepare()
        self._odometry = make_odometry(self.rig, self._config, components)
        if self._save_map is not None:
            try:
                self._odometry.map_alignment.check_savable(self._save_map)
            except BaseException:
                self._odometry.close()
                raise
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="map")
        self._update: Future[None] | None = None  # extension of the map by the newest frame
        self._lock = threading.Lock()
        self._statistics = RunStatistics()
        self._unpaired = 0
        self._begun = time.perf_counter()
        self._end = ""  # why no further frame is taken

    def track(
        self,
        stamp_ns: int,
        left: Any,
        right: Any = None,
        depth: Any = None,
        mask: Any = None,
        *,
        further: Sequence[Any] = (),
        stamps_ns: Sequence[int] | None = None,
    ) -> Estimate:
        """The pose of the next frame.

        Images are copied; they are given as recorded, neither undistorted nor rectified.

        Args:
            stamp_ns: time of the frame in integer nanoseconds, above that of the frame before.
            left: image of camera 0: (H, W) in grey or (H, W, 3 or 4) in colour, uint8 or uint16.
                A rig may lack it, too: None.
            right: image of camera 1 at the same time, None if it is missing.
            depth: (H, W) of camera 0, as float metres or uint16 millimetres; 0, negative and NaN
                where unknown.
            mask: (H, W) bool or uint8, nonzero where the left image may be used, beside the masks
                of all frames (section `masks` of the settings).
            further: images of cameras 2, 3 and so on of a rig, None where one is missing.
            stamps_ns: times of all images by camera, where these have no common trigger.

        Raises:
            InputError: a value is of the wrong type, shape, size or order; the next call goes on.
            VoError: the odometry is closed, or has failed before.
        """
        with self._lock:
            self._check_open()
            frame = self._input.frame(stamp_ns, left, right, depth, mask, further, stamps_ns)
            if self._imu is not None:
                self._imu.newest_frame_ns = frame.stamp_ns
            try:
                self._finish_update()
                estimate = self._odometry.locate(frame)
                self._update = self._worker.submit(self._odometry.update_map)
            except BaseException as error:
                self._end = f"an earlier call failed ({type(error).__name__})"
                raise
            self._count(estimate, is_unpaired=left is None or self._lacks_partner(right, depth))
            return estimate

    def add_imu(self, stamp_ns: int, gyro: Any, accel: Any) -> None:
        """A sample of the inertial sensor, of `imu=`; in order, in any thread, never waiting.

        A frame uses the samples that came before it: give all until its time, and one after it.

        Args:
            stamp_ns: time in integer nanoseconds, above that of the sample before.
            gyro: (3,) angular rates in rad/s, in the frame of the sensor.
            accel: (3,) specific forces in m/s², upwards 9.81 at rest.

        Raises:
            InputError: a value is no sample, or comes out of order, and is left out; or the samples
                of the first 4 s cannot be used, such as in degrees, and none is.
            VoError: the odometry is closed, or has no inertial sensor.
        """
        if self._imu is None:
            raise VoError("there is no inertial sensor; create the odometry with imu=True")
        if self._end:
            raise VoError(f"this odometry takes no more samples: {self._end}; create another one")
        self._imu.add(stamp_ns, gyro, accel)

    def predict(self, stamp_ns: int) -> PredictedPose | None:
        """The pose at any time: between frames or, for up to 3 s, after the newest.

        Between frames with a pose, up to 1 s apart, it is interpolated. After the newest one it is
        predicted by the samples of the inertial sensor until then, with a covariance, once its
        velocity is known; else by constant velocity, for up to 1 s. Results do not depend on calls.

        Raises:
            InputError: the time is no integer.
        """
        stamp = stamp_of(stamp_ns)
        with self._lock:
            self._finish_update()
            store = self._odometry.trajectory
            if len(store.frames) and stamp <= int(store.frames["stamp_ns"][-1]):
                return pose_between(store, stamp)
            return None if self._end else self._odometry.predict(stamp)

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
                inertial=self._inertial_use(),
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
                    found = contradiction_faults(self._inertial_use(), is_handled=False)
                    self._statistics.faults.add(found)
                    if self._save_map is not None and self._statistics.frames:
                        self._odometry.map_alignment.save_map(self._save_map, _SOURCE)
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

    def _inertial_use(self) -> InertialUse | None:
        found = self._odometry.map_alignment.inertial
        return found if self._imu is None else self._imu.use(found)

    def _facts(self) -> RunFacts:
        frames = len(self._statistics.frames)
        return RunFacts(
            source=_SOURCE,
            format="library",
            mode=mode_of(self.rig),
            has_ground_truth=False,
            seed=self._config.seed,
            start=0,
            end=frames,
            stride=1,
            requested=frames,
            opening_warnings=() if self._imu is None else self._imu.warnings(),
        )


def _check_maps(config: Config, save_map: Path | None, calibration: object) -> None:
    check_maps(config.memory, saves=save_map is not None)
    file = Path(calibration) if isinstance(calibration, str | Path) else None
    vocabulary = Path(config.memory.vocabulary) if config.memory.vocabulary else None
    refuse_to_overwrite((file, vocabulary), (save_map,))
