"""The calls that the odometry of one or two cameras and that of a rig have in common."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Generic, Protocol, TypeVar

from vo.base.faults import Fault
from vo.base.records.snapshot import Snapshot
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Estimate, Floats, Frame, PredictedPose, Rig, State
from vo.engine.backend.optimizer import WindowOptimizer
from vo.engine.frontend.lazy_future import LazyFuture
from vo.engine.map_alignment import MapAlignment
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.recovery import AnyFrame, Segments
from vo.engine.snapshot import FrameResult, make_estimate, make_snapshot
from vo.engine.tracking.motion_model import PosePrior
from vo.engine.trajectory.builder import TrajectoryBuilder
from vo.engine.trajectory.map_frame import Anchor
from vo.engine.trajectory.store import TrajectoryStore

FrameT = TypeVar("FrameT", bound=AnyFrame)

_REST_S = 2e-3  # between two frames, from which a program waits for the second


class Preprocessor(Protocol[FrameT]):
    """Prepares frames, in threads where there are any."""

    is_eager: bool

    def submit(self, frame: Frame) -> LazyFuture[FrameT]:
        """A frame to be preprocessed."""
        ...

    def ahead(self, frames: Iterable[Frame]) -> Iterator[LazyFuture[FrameT]]:
        """All frames, each started while the one before it is tracked."""
        ...

    def close(self) -> None:
        """End the threads."""
        ...


class PosePredictor(Protocol):
    """Knows where the camera will be."""

    def ahead(self, stamp_ns: int) -> Floats | PosePrior | None:
        """The pose at a later time than the newest frame; None if it is unknown."""
        ...


class OdometryBase(ABC, Generic[FrameT]):
    """Computes poses from frames, one `track` a frame; `close` it at the end.

    Attributes:
        hidden: ratio of the recorded images that masks of the whole run hide, by camera.
        map_alignment: closes loops and uses an inertial sensor, if it is asked to.
        networks: those that have been loaded.
    """

    hidden: tuple[float, ...]
    map_alignment: MapAlignment
    networks: list[Any]
    _preprocessor: Preprocessor[FrameT]
    _recovery: Segments[FrameT]
    _tracker: PosePredictor
    _trajectory: TrajectoryBuilder
    _map: LocalMap
    _window_optimizer: WindowOptimizer

    def __init__(self) -> None:
        self.stopwatch = Stopwatch()
        self._expects_keyframe = False  # whether the next frame probably becomes a keyframe
        self._result: FrameResult | None = None  # of the newest frame
        self._anchor: Anchor | None = None  # in the map frame, when the newest frame was tracked
        self._has_moved = False  # whether the newest frame has added or moved keyframes
        self._is_counted = False  # whether `_next_frame` was called for the next frame
        self._updated_s: float | None = None  # when `update_map` ended
        self._rests = False  # whether there was time between the newest two frames

    def track(self, frame: Frame) -> Estimate:
        """Process the next frame."""
        return self._process(self._preprocessor.submit(frame))

    def track_all(self, frames: Iterable[Frame]) -> Iterator[Estimate]:
        """Process frames, each of them preprocessed while the one before it is tracked."""
        for pending in self._preprocessor.ahead(frames):
            yield self._process(pending)

    def locate(self, frame: Frame) -> Estimate:
        """The pose of the next frame, at once.

        The rest is left to `update_map`; keyframes that it adds or moves are in the next estimate.
        Where there is time between frames, nothing else runs beside this.
        """
        now, since = time.perf_counter(), self._updated_s
        self._rests = since is not None and now - since > _REST_S
        self._locate(self._preprocessor.submit(frame))
        return self._estimate()

    def update_map(self) -> None:
        """Make the newest frame a keyframe if the map needs one; in any thread, before the next.

        What is due with the next frame is applied, too, where that changes no result.
        """
        self._extend_map()
        if not self._is_counted and not self.map_alignment.reads_map(self._recovery.segment):
            self._is_counted = self._count_early()
        self._updated_s = time.perf_counter()

    def _extend_map(self) -> None:
        """Make the newest frame a keyframe if the map needs one."""
        result = self._result
        if result is None or not result.is_keyframe or result.keyframe is not None:
            return
        self._result = result._replace(keyframe=self._add_keyframe(result))

    def predict(self, stamp_ns: int) -> PredictedPose | None:
        """The pose after the newest tracked frame, None if it is unknown; after `update_map`."""
        ahead, segment = self._tracker.ahead(stamp_ns), self._recovery.segment
        return self._trajectory.predicted(ahead, segment, self._anchor)

    def finish(self) -> Mapping[str, float]:
        """Apply the last results of the optimizer; the time by stage that it took."""
        self._extend_map()
        self._apply()
        self.map_alignment.finish(self._map)
        return self.stopwatch.take()

    def close(self) -> None:
        """Hand the map to the keyframe store, and end threads and processes."""
        self._map.clear()
        self.map_alignment.close()
        self._window_optimizer.close()
        self._preprocessor.close()

    @property
    def trajectory(self) -> TrajectoryStore:
        """The path so far."""
        return self._trajectory.store

    def corrected(self, rig: Rig) -> Rig:
        """A rig of more than two cameras where they were found to be."""
        return rig

    def snapshot(self) -> Snapshot:
        """The newest frame and the local map for display, before the next frame is tracked."""
        anchor = self.trajectory.anchor(self._recovery.segment)
        return make_snapshot(self._newest, self._map, anchor, has_moved=self._has_moved)

    @abstractmethod
    def _track(self, frame: FrameT) -> FrameResult:
        """Track a frame in the map, or start a map with it."""

    @abstractmethod
    def _add_keyframe(self, result: FrameResult) -> Keyframe:
        """Make a tracked frame a keyframe."""

    @abstractmethod
    def _apply(self) -> None:
        """Apply the pending result of the optimizer."""

    @abstractmethod
    def _next_frame(self) -> None:
        """Count a frame, and apply the result of the optimizer that is due with it."""

    def _count_early(self) -> bool:
        """Call `_next_frame` before the next frame, if its result does not depend on that."""
        self._next_frame()
        return True

    def _count_frame(self) -> None:
        """Call `_next_frame` for the frame that is tracked, unless `update_map` did."""
        if not self._is_counted:
            self._next_frame()
        self._is_counted = False

    @property
    def _newest(self) -> FrameResult:
        if self._result is None:
            raise RuntimeError("no frame has been tracked yet")
        return self._result

    @property
    def _expects_all(self) -> bool:
        """Whether each of the next frames probably becomes a keyframe."""
        return False

    @property
    def _faults(self) -> tuple[Fault, ...]:
        """Faults of the calibration."""
        return ()

    def _process(self, pending: LazyFuture[FrameT]) -> Estimate:
        self._locate(pending)
        self._extend_map()
        return self._estimate()

    def _locate(self, pending: LazyFuture[FrameT]) -> None:
        """Track a frame, and others again where it shows that they were misled or lost."""
        frame = self._preprocess(pending)
        self._extend_map()
        self.map_alignment.begin_frame(frame.index, self._recovery.segment, self._map)
        for each in self._recovery.frames(frame):
            self._extend_map()
            self._result = self._track(each)
        self._anchor = self._trajectory.store.anchor(self._recovery.segment)
        is_lost = self._recovery.state is not State.TRACKING
        self._preprocessor.is_eager = is_lost or (self._expects_all and not self._rests)

    @timed("features")
    def _preprocess(self, pending: LazyFuture[FrameT]) -> FrameT:
        frame = pending.result()
        is_expected = self._expects_keyframe and not self._rests
        if is_expected or self._recovery.state is not State.TRACKING:
            frame.start_features()
        return frame

    def _estimate(self) -> Estimate:
        """The newest frame's result."""
        result, segment, path = self._newest, self._recovery.segment, self._trajectory
        moved = path.take_moved()
        self._has_moved = bool(moved)
        pose = result.world_from_cam
        return make_estimate(
            result,
            self._recovery.state,
            segment,
            world_from_cam0=None if pose is None else path.map_from_cam0(pose, self._anchor),
            predicted=path.predicted(result.predicted, segment, self._anchor),
            faults=result.every_fault + self._faults,
            keyframes=moved,
            landmark_ids=self._map.id.copy() if moved else None,
            stage_ms=self.stopwatch.take(),
            disparity_offset_px=self._map.rig.disparity_offset_px,
        )
