"""Memory of a run: stores keyframes, closes loops, and places all keyframes in one map."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

from vo.base.records.closed_loops import ClosedLoop, MapUse, Relocalisation
from vo.base.records.metric_scale import MetricScale
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Bytes, Floats
from vo.engine.backend.pose_graph import PoseGraph
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.keyframe_store import StoredLandmarks
from vo.engine.mapping.local_map import LocalMap
from vo.engine.memory.connections import Connections
from vo.engine.memory.early_search import EarlySearch
from vo.engine.memory.inertial_poses import InertialPoses
from vo.engine.memory.loop_bundle import LoopBundle
from vo.engine.memory.map_worlds import WorldsInMap
from vo.engine.memory.marker_loops import MarkerLoops
from vo.engine.memory.place_maker import PlaceMaker
from vo.engine.memory.placed_worlds import in_metres, of_worlds, with_adjusted
from vo.engine.memory.recognition import Recognised, Recogniser
from vo.engine.memory.reports import closed_loop, correction_of, relocalisation
from vo.engine.places.records import InertialPose, Loop, PathKeyframe, PlacedKeyframes, PlaceKey
from vo.engine.trajectory.builder import TrajectoryBuilder

# A result of the pose graph is applied after so many further keyframes; the number is fixed,
# so that the path does not depend on the speed of the optimizer.
_LATENCY = 3
_FRAME_LATENCY = 5  # ... or so many frames, while the camera is in a segment of its own
_MIN_JOINING = 3  # keyframes of one segment with loops to others, fewer of which never join them
_SPACING = 10  # minimum of keyframes from one graph to the next
_SPACING_RATIO = 0.05  # of all keyframes, if that is more: large graphs take longer


class Memory:
    """Receives the keyframes that are removed from the local map; a `KeyframeStore`.

    Neither the local map nor tracking is changed. The result for each keyframe is applied with the
    next one, and that of the pose graph a fixed number of keyframes later. While the camera is in a
    segment that nothing connects with an older world, its keyframes are searched as soon as they
    are made, and results are applied a fixed number of frames later.

    Attributes:
        stopwatch: measures the stage `memory`.
        markers: connects keyframes that see the same marker.

    Args:
        maker: makes places.
        recogniser: stores and recognises them.
        graph: places them in the map frame.
        trajectory: follows.
        stopwatch: measures the stages.
        worlds: those of a loaded map.
        inertial: gives the graph metric poses of a single camera, None without a sensor.
        bundle: adjusts worlds with loops at the end, or None.
    """

    def __init__(
        self,
        maker: PlaceMaker,
        recogniser: Recogniser,
        graph: PoseGraph,
        trajectory: TrajectoryBuilder,
        stopwatch: Stopwatch,
        worlds: WorldsInMap,
        inertial: InertialPoses | None = None,
        bundle: LoopBundle | None = None,
    ) -> None:
        self.stopwatch = stopwatch
        self._maker = maker
        self._recogniser = recogniser
        self._early = EarlySearch(maker, recogniser)
        self._graph = graph
        self._trajectory = trajectory
        self._worlds = worlds
        self.markers = MarkerLoops(
            trajectory.cam0_from_rectified, worlds.markers, is_metric=maker.is_metric
        )
        self._inertial = inertial
        self._bundle = bundle
        self._adjusted: list[PlacedKeyframes] = []  # worlds after the adjustment
        self._wrong: tuple[PlaceKey, ...] = ()  # see `PlacedKeyframes`
        self._future: Future[Recognised] | None = None  # of the newest stored keyframe
        self._connections = Connections(trajectory.store, worlds)
        self._frames = self._connections.frames
        self._added = 0  # number of keyframes
        self._frame = 0  # number of frames
        self._segment = 0  # of the newest frame
        self._loops: list[Loop] = []
        self._closed: dict[int, ClosedLoop] = {}  # by index of the loop
        self._applied: set[int] = set()  # indices of loops that were accepted once
        self._relocalisations: list[Relocalisation] = []
        self._submitted: int | None = None  # number of loops of the graph that is optimised
        self._placed_loops = 0  # number of loops in the newest result
        self._due = 0  # number of keyframes at which the result is applied
        self._due_frame: int | None = None  # ... or number of frames
        self._next = 0  # number of keyframes from which the next graph may be submitted
        self._unmarked: list[int] = []  # indices of loops that no frame has been placed by yet
        self._found: Relocalisation | None = None  # ... and a relocalisation
        self._is_familiar = False  # whether the newest place resembles an older one
        self._is_finished = False

    @property
    def closed_loops(self) -> tuple[ClosedLoop, ...]:
        """Loops that the pose graph accepts, in the order in which they were found."""
        return tuple(self._closed[n] for n in sorted(self._closed))

    @property
    def relocalisations(self) -> tuple[Relocalisation, ...]:
        """Segments whose place in an older world was found while the camera was in them."""
        return tuple(self._relocalisations)

    @property
    def map_use(self) -> MapUse | None:
        """The loaded map, None without one."""
        return self._worlds.use

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
        if self._submitted is not None and self._added >= self._due:
            self._apply_placed()
        is_due = self._has_new_loops() or self._awaits_graph()
        if self._submitted is None and self._added >= self._next and is_due:
            self._submit()
        of_path = self._maker.follow(keyframe)
        if self._bundle is not None:
            self._bundle.add(of_path.key, keyframe, landmarks())
        self._add_loops(self.markers.add(of_path))
        is_known = any(loop.later == of_path.key and loop.marker is None for loop in self._loops)
        if is_known or self._is_familiar or self._maker.shows_new(keyframe):
            place = self._maker.make(of_path, keyframe, landmarks(), image)
            self._future = self._recogniser.add(place, searches=not is_known)
        else:
            self._add_to_graph(of_path)
        self._added += 1

    def begin_frame(self, index: int, segment: int, local_map: LocalMap) -> None:
        """Find a lost camera again, and note the first frame whose pose is as it was corrected."""
        self._frame, self._segment = self._frame + 1, segment
        if self._connections.is_apart(segment):
            self._relocalise(local_map)
        for n in self._unmarked:
            self._closed[n] = replace(self._closed[n], corrected_from=index)
        if self._found is not None and self._found.segment == segment:
            self._relocalisations.append(replace(self._found, frame=index))
        self._unmarked, self._found = [], None

    @timed("memory")
    def _relocalise(self, local_map: LocalMap) -> None:
        """Search for the newest keyframe of the local map, and apply results that are due."""
        found = self._early.result(self._frame)
        if found is not None:
            self._note_stored()  # it may be recognised by the newest stored keyframe
            self._note(found)
        if self._submitted is not None and self._due_frame is None:
            self._due_frame = self._frame + _FRAME_LATENCY
        if self._due_frame is not None and self._frame >= self._due_frame:
            self._apply_placed()
        if self._submitted is None and self._joins_enough() and self._has_new_loops():
            self._submit()
        if self._connections.is_apart(self._segment):
            self._early.submit(self._frame, local_map)

    def forget_from(self, frame_index: int) -> None:
        """Forget all keyframes from a frame on, which are tracked anew, and their loops."""
        self._apply_recognised()
        if self._submitted is not None:
            self._graph.result()  # may place forgotten keyframes, so it is not applied
            self._submitted, self._due_frame = None, None
        gone = tuple(key for key, frame in self._frames.items() if frame.index >= frame_index)
        for key in gone:
            del self._frames[key]
        self._keep_loops([n for n, loop in enumerate(self._loops) if loop.later in self._frames])
        self._relocalisations = [r for r in self._relocalisations if r.frame < frame_index]
        self._found = None
        self._recogniser.remove(gone)
        self.markers.forget_from(frame_index)
        if self._bundle is not None:
            self._bundle.remove_from(frame_index)
        self._graph.remove_keyframes(gone)

    def _keep_loops(self, kept: Sequence[int]) -> None:
        """Forget all loops but those of increasing indices."""
        self._placed_loops = sum(n < self._placed_loops for n in kept)
        self._closed = {i: self._closed[n] for i, n in enumerate(kept) if n in self._closed}
        self._applied = {i for i, n in enumerate(kept) if n in self._applied}
        self._unmarked = [i for i, n in enumerate(kept) if n in self._unmarked]
        self._loops = [self._loops[n] for n in kept]
        self._graph.keep_loops(kept)

    @timed("memory")
    def finish(self, local_map: LocalMap) -> None:
        """Store the keyframes of the local map, and apply all results."""
        local_map.hand_over([self])
        self._is_finished = True
        self._apply_recognised()
        self._add_loops(self.markers.finish())
        if self._submitted is not None:
            self._apply_placed()
        is_doubted = any(loop.marker in self.markers.repeated for loop in self._loops)
        if self._placed_loops < len(self._loops) or self._awaits_graph() or is_doubted:
            self._submit()
            self._apply_placed()
        self._unmarked.clear()
        if self._bundle is not None and self._closed:
            self._adjust(self._bundle)

    def is_metric(self, segment: int) -> bool:
        """Whether lengths of a segment of one camera are metres by the loaded map."""
        return self._trajectory.store.world(segment) in self._worlds.metric

    def check_savable(self, path: Path) -> None:
        """Check before the first frame that the run can be saved with the loaded map.

        Raises:
            OutputError: the loaded map is of another camera.
        """
        self._recogniser.check_savable(path)

    def save_map(self, path: Path, source: str, scales: Mapping[int, MetricScale]) -> None:
        """Write the stored keyframes and where they are to a file, after `finish`.

        Args:
            path: the file.
            source: name of the recording.
            scales: by number of the world, to write those in metres.

        Raises:
            OutputError: the file cannot be written, or the loaded map is of another camera.
        """
        self._graph.submit(self._inertial_poses(), self.markers.repeated)
        placed = self._graph.result()
        if self._inertial is not None:
            placed = self._inertial.placement.to_metres(placed, self._maker.session)
        placed = with_adjusted(placed, self._adjusted)
        world_of = self._trajectory.store.world
        known = ((n, self._frames[k]) for n, k in enumerate(placed.keys) if k in self._frames)
        worlds = {n: world_of(frame.segment) for n, frame in known}
        by_sensor = () if self._inertial is None else self._inertial.placement.metric_worlds
        placed, metric = in_metres(placed, worlds, scales, by_sensor)
        metric |= self._worlds.metric_of(placed)
        # A map knows keyframes by their looks, and not those that only a marker connects.
        accepted = [self._loops[n] for n in sorted(self._closed) if self._loops[n].marker is None]
        metric_worlds, markers = tuple(sorted(metric)), self.markers.known
        self._recogniser.save_map(path, source, placed, accepted, metric_worlds, markers)

    def close(self) -> None:
        """End threads and processes."""
        self._is_finished = True
        self._recogniser.close()
        self._graph.close()

    def _adjust(self, bundle: LoopBundle) -> None:
        """Adjust the worlds with loops once more, by all observations, unless some are wrong."""
        loops = [self._loops[n] for n in sorted(self._closed)]
        worlds = {self._trajectory.store.world(self._frames[loop.later].segment) for loop in loops}
        session = self._maker.session
        wrong = [self._frames[key].segment for key in self._wrong if key in self._frames]
        worlds -= {self._trajectory.store.world(segment) for segment in wrong}
        for world in sorted(worlds - set(self._worlds.met)):
            placed = bundle.adjusted(self._trajectory.placed(world, session), loops)
            if placed is not None:
                self._trajectory.place(placed, session)
                self._adjusted.append(placed)

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
        self._add_loops(recognised.loops)
        removed = (key for key in recognised.removed if not self.markers.needs(key))
        self._graph.remove_keyframes(tuple(removed))

    def _add_to_graph(self, keyframe: PathKeyframe) -> None:
        self._frames[keyframe.key] = keyframe.frame
        self._graph.add_keyframe(keyframe)

    def _add_loops(self, loops: Sequence[Loop]) -> None:
        for loop in loops:
            self._graph.add_loop(loop)
            self._loops.append(loop)

    def _has_new_loops(self) -> bool:
        """Whether there are loops that no graph had, or enough of them to connect the segment."""
        new = self._loops[self._placed_loops :]
        joins = self._connections.is_apart(self._segment) and not self._joins_enough()
        return any(
            not (joins and self._connections.is_joining(loop, self._segment)) for loop in new
        )

    def _joins_enough(self) -> bool:
        return (
            sum(
                loop.support
                for loop in self._loops
                if self._connections.is_joining(loop, self._segment)
            )
            >= _MIN_JOINING
        )

    def _submit(self) -> None:
        self._graph.submit(self._inertial_poses(), self.markers.repeated)
        self._submitted, self._due = len(self._loops), self._added + _LATENCY
        self._due_frame = None
        if self._connections.is_apart(self._segment):
            self._due_frame = self._frame + _FRAME_LATENCY
        self._next = self._added + max(_SPACING, math.ceil(_SPACING_RATIO * self._added))

    def _apply_placed(self) -> None:
        """Apply the result of the pose graph to the trajectory."""
        placed = self._graph.result()
        assert self._submitted is not None
        loops = self._loops[: self._submitted]
        self._wrong = placed.wrong
        self._placed_loops, self._submitted, self._due_frame = self._submitted, None, None
        rejected = {(loop.earlier, loop.later, loop.marker) for loop in placed.rejected}
        ends = [(loop.earlier, loop.later, loop.marker) for loop in loops]
        accepted = [n for n, each in enumerate(ends) if each not in rejected]
        self.markers.refuse(placed.rejected)
        touched = sorted({*accepted, *self._closed})
        if self._inertial is not None:  # all worlds that were placed once
            self._applied.update(accepted)
            touched = sorted(self._applied)
        self._closed = {n: loop for n, loop in self._closed.items() if n in accepted}
        new = [n for n in accepted if n not in self._closed]
        if not touched:
            return
        before = {n: self._pose(loops[n].later) for n in new}
        apart = {n: self._connections.is_joined_by(loops[n]) for n in new}
        was_apart = self._connections.is_apart(self._segment)
        connected = of_worlds(placed, [loops[n] for n in touched])
        connected = self._worlds.numbered(connected, self._frames)
        placer = self._trajectory if self._inertial is None else self._inertial.placement
        placer.place(connected, self._maker.session)
        for n in new:
            moved = None if apart[n] else correction_of(before[n], self._pose(loops[n].later))
            self._closed[n] = closed_loop(
                loops[n], self._connections.ends(loops[n]), moved, placed.wrong
            )
        self._unmarked = [n for n in self._unmarked if n in self._closed] + new
        self._relocalisations = [
            r for r in self._relocalisations if not self._connections.is_apart(r.segment)
        ]
        if was_apart and not self._connections.is_apart(self._segment):
            joining = [n for n in new if self._connections.is_joining(loops[n], self._segment)]
            self._found = self._relocalisation(joining, before)

    def _relocalisation(
        self, joining: Sequence[int], before: dict[int, Floats]
    ) -> Relocalisation | None:
        """The relocalisation by new loops from the segment of the newest frame to another one."""
        if not joining:  # it is connected by loops of others to it
            return None
        newest = max(joining, key=lambda n: self._frames[self._loops[n].later].index)
        loop = self._loops[newest]
        correction = correction_of(before[newest], self._pose(loop.later))
        return relocalisation(self._connections.ends(loop), loop.inliers, len(joining), correction)

    def _awaits_graph(self) -> bool:
        return self._inertial is not None and self._inertial.placement.awaits_graph

    def _inertial_poses(self) -> dict[PlaceKey, InertialPose]:
        if self._inertial is None:
            return {}
        session = self._maker.session
        return {PlaceKey(session, k): pose for k, pose in self._inertial.graph_poses().items()}

    def _pose(self, key: PlaceKey) -> Floats:
        (pose,) = self._trajectory.store.keyframes_by_id([key.keyframe])
        return pose.world_from_cam0
