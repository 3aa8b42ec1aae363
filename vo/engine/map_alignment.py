"""What places keyframes in the map frame: loops, an inertial sensor, and a final adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.errors import OutputError
from vo.base.records.closed_loops import ClosedLoop, MapUse, Relocalisation
from vo.base.records.inertial_use import InertialUse
from vo.base.types import Trajectory
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.tracked_frame import TrackedFrame
from vo.engine.places.records import Loop
from vo.engine.trajectory.store import TrajectoryStore

if TYPE_CHECKING:  # many runs need none of them
    from vo.engine.inertial_path.alignment import InertialAlignment
    from vo.engine.markers.marker_problem import MarkerView
    from vo.engine.memory.final_adjustment import FinalAdjustment
    from vo.engine.memory.memory import Memory


class MapAlignment:
    """Works beside tracking, without changing it; without memory and sensor it does nothing."""

    def __init__(
        self,
        memory: Memory | None,
        inertial: InertialAlignment | None,
        final: FinalAdjustment | None = None,
    ) -> None:
        self._memory = memory
        self._inertial = inertial
        self._final = final

    @property
    def closed_loops(self) -> tuple[ClosedLoop, ...]:
        """Loops that were closed so far."""
        return () if self._memory is None else self._memory.loops.closed_loops

    @property
    def accepted_loops(self) -> list[Loop]:
        """Loops that the path agrees with."""
        return [] if self._memory is None else self._memory.loops.accepted

    @property
    def relocalisations(self) -> tuple[Relocalisation, ...]:
        """Segments whose place in an older world was found while the camera was in them."""
        return () if self._memory is None else self._memory.loops.relocalisations

    @property
    def map_use(self) -> MapUse | None:
        """The loaded map, None without one."""
        return None if self._memory is None else self._memory.in_map.use

    @property
    def inertial(self) -> InertialUse | None:
        """What became of the inertial sensor, None without one."""
        return None if self._inertial is None else self._inertial.use

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user about markers that close no loops."""
        return () if self._memory is None else self._memory.markers.notes

    def reads_map(self, segment: int) -> bool:
        """Whether `begin_frame` looks at the local map, which must not change between frames."""
        is_apart = self._memory is not None and self._memory.loops.is_apart(segment)
        return is_apart or self._inertial is not None

    def begin_frame(self, index: int, segment: int, local_map: LocalMap) -> None:
        """Before a frame is tracked, after all updates of the map of its segment."""
        if self._inertial is not None:
            self._inertial.begin_frame(local_map)
        if self._memory is not None:
            self._memory.begin_frame(index, segment, local_map)

    def see_frame(self, frame: PreprocessedFrame, tracked: TrackedFrame, newest: Keyframe) -> None:
        """After a frame was tracked that does not become a keyframe; the newest one is given."""
        if self._inertial is not None:
            self._inertial.tracked.see(frame, tracked, newest)
        if self._final is not None:
            self._final.frames.see(frame, tracked, newest)

    def see_markers(
        self, frame_index: int, views: Sequence[MarkerView], repeated: Sequence[int]
    ) -> None:
        """After a frame was tracked: views of markers that it shows once, ids of repeated ones."""
        if self._memory is not None:
            self._memory.markers.see(frame_index, views, repeated)

    def see_keyframe(self, keyframe: Keyframe, frame: PreprocessedFrame) -> None:
        """After a frame has become a keyframe."""
        if self._final is not None:
            self._final.see(keyframe, frame)

    def forget_from(self, frame_index: int) -> None:
        """Forget all keyframes from a frame on, which are tracked anew."""
        if self._inertial is not None:
            self._inertial.forget_from(frame_index)
        if self._memory is not None:
            self._memory.forget_from(frame_index)
        if self._final is not None:
            self._final.forget_from(frame_index)

    def finish(self, local_map: LocalMap) -> None:
        """After the last frame: take in the keyframes of the local map, and apply all results."""
        if self._inertial is not None:
            self._inertial.finish(local_map)
        if self._memory is not None:
            self._memory.finish(local_map)
        if self._final is not None:
            unsure = set() if self._memory is None else self._memory.unsure_worlds
            joint = None if self._inertial is None else self._inertial.joint
            moved = self._final.finish(local_map, self.accepted_loops, unsure, joint)
            if self._memory is not None:
                self._memory.adjusted += moved
        if self._inertial is not None:
            self._inertial.fill_gaps()

    def path_before_loops(self, store: TrajectoryStore, *, in_metres: bool) -> Trajectory:
        """The path before all loops, after `finish`: each segment in a world of its own.

        Segments that the inertial sensor has joined without images stay together.
        """
        if self._inertial is not None and self._inertial.map_poses.has_poses:
            return self._inertial.map_poses.path_before_loops()
        return store.odometry(in_metres=in_metres)

    def check_savable(self, path: Path) -> None:
        """Check before the first frame that there will be one map to save.

        Raises:
            OutputError: there will be none, or the loaded map is of another camera.
        """
        self._savable(path).check_savable(path)

    def save_map(self, path: Path, source: str) -> None:
        """Write the stored keyframes and where they are to a file, after `finish`.

        `source`: name of the recording.

        Raises:
            OutputError: the file cannot be written; errors of `check_savable`.
        """
        self._savable(path).save_map(path, source)

    def close(self) -> None:
        """End threads and processes."""
        if self._memory is not None:
            self._memory.close()

    def _savable(self, path: Path) -> Memory:
        if self._memory is None:
            raise OutputError(
                f"there is no map to save to {path}: loops are not closed; use `memory.loops=true`"
            )
        return self._memory
