"""Memory of a run: stores keyframes, closes loops, and places all keyframes in one map."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Bytes
from vo.engine.backend.pose_graph import PoseGraph
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.keyframe_store import StoredLandmarks
from vo.engine.mapping.local_map import LocalMap
from vo.engine.memory.early_search import EarlySearch
from vo.engine.memory.graph_schedule import GraphSchedule
from vo.engine.memory.loop_bundle import LoopBundle
from vo.engine.memory.loop_ledger import LoopLedger
from vo.engine.memory.map_writer import check_savable, in_metres, write_run
from vo.engine.memory.marker_loops import MarkerLoops
from vo.engine.memory.place_maker import PlaceMaker
from vo.engine.memory.recognition import Recognised, Recogniser
from vo.engine.memory.registered_keyframes import of_worlds, with_adjusted
from vo.engine.memory.run_in_map import RunInMap
from vo.engine.places.records import InertialPose, PathKeyframe, PlaceKey, RegisteredKeyframes
from vo.engine.trajectory.builder import TrajectoryBuilder

if TYPE_CHECKING:  # many runs have no inertial sensor
    from vo.engine.inertial_path.alignment import InertialAlignment


class Memory:
    """Receives the keyframes that are removed from the local map; a `KeyframeStore`.

    Neither the local map nor tracking is changed. The result for each keyframe is applied with the
    next one, and that of the pose graph a fixed number of keyframes later. While the camera is in a
    segment that nothing connects with an older world, its keyframes are searched as soon as they
    are made, and results are applied a fixed number of frames later.

    Attributes:
        markers: connects keyframes that see the same marker.
        loops: that were found, and what became of them.
        in_map: where the run is in the loaded map.
        adjusted: keyframes of worlds after an adjustment at the end.
    """

    def __init__(
        self,
        maker: PlaceMaker,
        recogniser: Recogniser,
        graph: PoseGraph,
        trajectory: TrajectoryBuilder,
        stopwatch: Stopwatch,
        in_map: RunInMap,
        inertial: InertialAlignment | None = None,
        bundle: LoopBundle | None = None,
    ) -> None:
        self.stopwatch = stopwatch
        self.in_map = in_map
        self.loops = LoopLedger(trajectory.store, in_map)
        self.markers = MarkerLoops(
            trajectory.cam0_from_rectified, in_map.markers, is_metric=maker.is_metric
        )
        self._maker = maker
        self._recogniser = recogniser
        self._early = EarlySearch(maker, recogniser)
        self._graph = graph
        self._schedule = GraphSchedule()
        self._trajectory = trajectory
        self._inertial = inertial
        self._bundle = bundle
        self.adjusted: list[RegisteredKeyframes] = []
        self._wrong: tuple[PlaceKey, ...] = ()  # see `RegisteredKeyframes`
        self._future: Future[Recognised] | None = None  # of the newest stored keyframe
        self._segment = 0  # of the newest frame
        self._is_familiar = False  # whether the newest place resembles an older one
        self._is_finished = False

    @timed("memory")
    def add(
        self, keyframe: Keyframe, landmarks: Callable[[], StoredLandmarks], image: Bytes
    ) -> None:
        """Add a keyframe, and apply results that are due.

        One that shows little more than the last place, which resembles no older one, becomes a part
        of the path only.
        """
        if self._is_finished:  # the odometry hands the rest over once more when it is closed
            return
        self._apply_recognised()
        if self._schedule.is_due:
            self._apply_graph()
        if self._schedule.may_begin and (self.loops.has_new(self._segment) or self._awaits_graph()):
            self._submit()
        of_path = self._maker.follow(keyframe)
        if self._bundle is not None:
            self._bundle.add(of_path.key, keyframe, landmarks())
        self.loops.add(self.markers.add(of_path))
        known = (loop for loop in self.loops.loops if loop.marker is None)
        is_known = any(loop.later == of_path.key for loop in known)
        if is_known or self._is_familiar or self._maker.shows_new(keyframe):
            place = self._maker.make(of_path, keyframe, landmarks(), image)
            self._future = self._recogniser.add(place, searches=not is_known)
        else:
            self._add_to_graph(of_path)
        self._schedule.keyframes += 1

    def begin_frame(self, index: int, segment: int, local_map: LocalMap) -> None:
        """Find a lost camera again, and note the first frame whose pose is as it was corrected."""
        self._schedule.frames += 1
        self._segment = segment
        if self.loops.is_apart(segment):
            self._relocalise(local_map)
        self.loops.begin_frame(index, segment)

    @timed("memory")
    def _relocalise(self, local_map: LocalMap) -> None:
        """Search for the newest keyframe of the local map, and apply results that are due."""
        found = self._early.result(self._schedule.frames)
        if found is not None:
            self._note_stored()  # it may be recognised by the newest stored keyframe
            self._note(found)
        if self._schedule.is_due_apart():
            self._apply_graph()
        is_ready = self.loops.joins_enough(self._segment) and self.loops.has_new(self._segment)
        if not self._schedule.is_pending and is_ready:
            self._submit()
        if self.loops.is_apart(self._segment):
            self._early.submit(self._schedule.frames, local_map)

    def forget_from(self, frame_index: int) -> None:
        """Forget all keyframes from a frame on, which are tracked anew, and their loops."""
        self._apply_recognised()
        if self._schedule.is_pending:
            self._result()  # may place forgotten keyframes, so it is not applied
        gone = self.loops.forget_from(frame_index)
        self._recogniser.remove(gone)
        self.markers.forget_from(frame_index)
        if self._bundle is not None:
            self._bundle.remove_from(frame_index)
        self._graph.remove_keyframes(gone, self.loops.loops)

    @timed("memory")
    def finish(self, local_map: LocalMap) -> None:
        """Store the keyframes of the local map, and apply all results."""
        local_map.hand_over([self])
        self._is_finished = True
        self._apply_recognised()
        self.loops.add(self.markers.finish())
        if self._schedule.is_pending:
            self._apply_graph()
        is_doubted = any(loop.marker in self.markers.repeated for loop in self.loops.loops)
        if self.loops.has_unjudged or self._awaits_graph() or is_doubted:
            self._submit()
            self._apply_graph()
        if self._bundle is not None and self.loops.accepted:
            self._adjust(self._bundle)

    def check_savable(self, path: Path) -> None:
        """Check before the first frame that the run can be saved with the loaded map.

        Raises:
            OutputError: the loaded map is of another camera.
        """
        check_savable(path, self._recogniser)

    def save_map(self, path: Path, source: str) -> None:
        """Write the stored keyframes and where they are to a file, after `finish`.

        Raises:
            OutputError: the file cannot be written, or the loaded map is of another camera.
        """
        self._submit()
        registered = self._result()
        if self._inertial is not None:
            registered = self._inertial.map_poses.to_metres(registered, self._maker.session)
        registered, metric = with_adjusted(registered, self.adjusted), set[int]()
        if not self._maker.is_metric:
            frames = enumerate(self.loops.frames.get(key) for key in registered.keys)
            segments = {row: frame.segment for row, frame in frames if frame is not None}
            registered, metric = in_metres(registered, segments, self._trajectory.store.metric)
        # A map knows keyframes by their looks, and not those that only a marker connects.
        loops = [loop for loop in self.loops.accepted if loop.marker is None]
        write_run(path, source, self._recogniser, registered, metric, loops, self.markers.known)

    def close(self) -> None:
        """End threads and processes."""
        self._is_finished = True
        self._recogniser.close()
        self._graph.close()

    @property
    def unsure_worlds(self) -> set[int]:
        """Worlds that are not adjusted: with wrong odometry, or in a loaded map."""
        frames, world_of = self.loops.frames, self._trajectory.store.world
        wrong = {world_of(frames[key].segment) for key in self._wrong if key in frames}
        return wrong | set(self.in_map.met)

    def _adjust(self, bundle: LoopBundle) -> None:
        """Adjust the worlds with loops once more, by all observations, unless some are wrong."""
        loops, frames, world_of = (
            self.loops.accepted,
            self.loops.frames,
            self._trajectory.store.world,
        )
        worlds = {world_of(frames[loop.later].segment) for loop in loops}
        session = self._maker.session
        for world in sorted(worlds - self.unsure_worlds):
            registered = bundle.adjusted(self._trajectory.registered(world, session), loops)
            if registered is not None:
                self._trajectory.move_keyframes(registered, session)
                self.adjusted.append(registered)

    def _apply_recognised(self) -> None:
        """Wait for the results of all searches."""
        self._note_stored()
        found = self._early.result()
        if found is not None:
            self._note(found)

    def _note_stored(self) -> None:
        """Wait for the result of the newest stored keyframe."""
        future, self._future = self._future, None
        if future is not None:
            recognised = future.result()
            self._is_familiar = recognised.is_familiar
            self._note(recognised)

    def _note(self, recognised: Recognised) -> None:
        """Add the result of a search to the graph."""
        self._add_to_graph(recognised.place)
        self.loops.add(recognised.loops)
        removed = (key for key in recognised.removed if not self.markers.needs(key))
        self._graph.remove_keyframes(tuple(removed), self.loops.loops)

    def _add_to_graph(self, keyframe: PathKeyframe) -> None:
        self.loops.frames[keyframe.key] = keyframe.frame
        self._graph.add_keyframe(keyframe)

    def _submit(self) -> None:
        poses: dict[PlaceKey, InertialPose] = {}
        if self._inertial is not None:
            session, known = self._maker.session, self._inertial.graph_poses()
            poses = {PlaceKey(session, number): pose for number, pose in known.items()}
        self._graph.submit(self.loops.submit(), poses, self.markers.repeated)
        self._schedule.begin(is_apart=self.loops.is_apart(self._segment))

    def _result(self) -> RegisteredKeyframes:
        """Wait for the result of the pose graph."""
        self._schedule.end()
        return self._graph.result(self._recogniser.unconfirmed)

    def _apply_graph(self) -> None:
        """Apply the result of the pose graph to the trajectory."""
        registered = self._result()
        self._wrong = registered.wrong
        self.markers.refuse(registered.rejected)
        is_inertial = self._inertial is not None
        loops = self.loops.judge(registered, self._segment, keeps_all=is_inertial)
        if not loops:
            return
        connected = self.in_map.numbered(of_worlds(registered, loops), self.loops.frames)
        path = self._trajectory if self._inertial is None else self._inertial.map_poses
        path.move_keyframes(connected, self._maker.session)
        self.loops.report(registered.wrong, self._segment)
        if self._bundle is not None:
            self._bundle.forget_wide(self._segment, self.loops.accepted)

    def _awaits_graph(self) -> bool:
        return self._inertial is not None and self._inertial.map_poses.awaits_graph
