"""Metric, upright poses of a run with an inertial sensor.

The visual odometry is left alone: keyframes and the covariances of their motions come from the
local map, and what the inertial sensor adds is applied to the trajectory, in the map frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vo.base.geometry.transforms import adjoint, inverse
from vo.base.records.inertial_use import InertialStates, InertialUse
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Floats, Ints
from vo.engine.inertial.agreement import Agreement
from vo.engine.inertial.chain import InertialChain
from vo.engine.inertial.initialisation import WRONG, tilt_sigma
from vo.engine.inertial.joint_path import JointPaths
from vo.engine.inertial.keyframe_states import KeyframeStates, Node, certain
from vo.engine.inertial.prediction import (
    InertialPredictor,
    KnownMotion,
    known_motion,
    without_inertial,
)
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import ACCEL_BIAS, GYRO_BIAS, LOG_SCALE
from vo.engine.inertial.time_offset import (
    OffsetSearch,
    different_clocks,
    measure_time_offset,
    regular_stamps,
)
from vo.engine.inertial_path.gaps import InertialGaps, tangent_of_cam0
from vo.engine.inertial_path.map_poses import EstimatedPose, InertialMapPoses
from vo.engine.inertial_path.turns import InertialTurns
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.keyframe_motion import motion_covariances
from vo.engine.mapping.local_map import LocalMap
from vo.engine.places.records import InertialPose
from vo.engine.trajectory.builder import TrajectoryBuilder


class InertialAlignment:
    """Estimates inertial states of the keyframes, and places those of a single camera by them.

    It is called at fixed frames, so that results do not depend on the speed of anything. Metric
    paths (stereo, depth) keep their world, and are estimated by both together at the end only.

    Attributes:
        stopwatch: measures the stage `inertial`.
        map_poses: where the keyframes of a single camera are by the sensor.
        contradiction: after `finish`, how it contradicts the images; None where it does not.
        joint: after `finish`, metric paths by images and sensor.
        tracked: frames between keyframes.

    `reader`: of a sensor with known extrinsics; its time offset is replaced where it is wrong.
    """

    def __init__(
        self,
        reader: SampleReader,
        predictor: InertialPredictor,
        trajectory: TrajectoryBuilder,
        stopwatch: Stopwatch,
        *,
        is_metric: bool,
    ) -> None:
        self.stopwatch = stopwatch
        self.contradiction: str | None = None
        sensor = reader.sensor
        self._reader = reader
        self._trajectory = trajectory
        self._is_metric = is_metric
        self._predictor = predictor
        assert sensor.cam0_from_imu is not None
        self._imu_from_cam0 = inverse(sensor.cam0_from_imu)
        self._adjoint = adjoint(sensor.cam0_from_imu)
        noise, imu_from_cam = predictor.noise, predictor.imu_from_cam
        self._chain = InertialChain(reader, noise, imu_from_cam, is_metric=is_metric)
        self.joint, self.tracked = JointPaths(noise), self._chain.tracked
        self._offset = OffsetSearch(reader)
        self._gaps = InertialGaps(trajectory, reader, predictor.noise, sensor.cam0_from_imu)
        self._turns = InertialTurns(trajectory, predictor, reader, self._imu_from_cam0)
        self._newest = -1  # id of the newest keyframe whose states were estimated
        self.map_poses = InertialMapPoses(trajectory, trajectory.cam0_from_rectified)
        # Of later segments of a metric path: the first segment of their world, and the transform
        # from their odometry frame to its own.
        self._joints: dict[int, tuple[int, Floats]] = {}
        self._fused: dict[int, InertialPose] = {}  # keyframes of a metric path, by id, at the end
        self._stamp_sigma_s = 0.0

    @property
    def use(self) -> InertialUse:
        """What is known by the sensor."""
        offset, found = self._offset.found, self.contradiction
        use = InertialUse(
            self._reader.sensor.name,
            time_offset_s=None if offset is None else offset.seconds,
            time_offset_sigma_s=None if offset is None else offset.sigma_s,
            is_contradiction=found is not None,
            used_time_offset_s=self._reader.time_offset_s,
            given_time_offset_s=self._reader.sensor.time_offset_s,
            stamp_sigma_s=self._stamp_sigma_s,
        )
        solved = self._chain.newest
        if solved is None:
            text = None if (reason := self._chain.reason) is None else reason.value
            is_error = reason in WRONG or found is not None
            return replace(use, reason=found or text, is_error=is_error)
        return replace(
            use,
            reason=found,
            is_error=found is not None,
            first_frame=self._chain.initialised_frame,
            metric_worlds=tuple(sorted(self.map_poses.metric_worlds)),
            states=self._states(solved),
        )

    @timed("inertial")
    def begin_frame(self, local_map: LocalMap) -> None:
        """Estimate the states of keyframes that were optimised since the last frame."""
        keyframes = [k for k in local_map.of_first_view if k.covariance is not None]
        if not keyframes or keyframes[-1].id == self._newest:
            return
        self._newest = keyframes[-1].id
        self._set(keyframes)
        solved = self._chain.update()
        frames = len(self._trajectory.store.frames)
        is_due = self._offset.is_due(frames, has_states=solved is not None)
        if is_due and self._measure_offset():
            self._chain.restart()
            solved = self._chain.update()
        self._place(solved)
        self._gaps.remember(solved)
        known = self._predictor.known = None if solved is None else self._known(solved, keyframes)
        if known is not None:
            self._predictor.gyro_bias = known.gyro_bias

    def forget_from(self, frame_index: int) -> None:
        """Forget all keyframes from a frame on, which are tracked anew."""
        self._chain.remove_from(frame_index)
        self._gaps.forget_from(frame_index)
        self._predictor.known = None
        self._predictor.in_windows.clear()
        self.map_poses.forget_from(frame_index)

    @timed("inertial")
    def finish(self, local_map: LocalMap) -> None:
        """Estimate all states together, after the last frame."""
        self._set(local_map.of_first_view)
        self._chain.update()
        if self._measure_offset():
            self._chain.read_again()
            if not self._chain.is_initialised:
                self._chain.update()
        frames = self._trajectory.store.frames["frame_index"]
        self._chain.tracked.follow(frames, self._trajectory.odometry())
        solved = self._chain.finish()
        if self._chain.agreement.contradiction is not None:
            solved = self._finished_by_regular_stamps() or solved
        self.contradiction = self._found_contradiction()
        if solved is not None:  # in another frame, which the pose graph does not know
            self.map_poses.begin_frame_of(solved.world)
        self._place(solved, keeps_earlier=False)
        if solved is not None and self._is_metric and self.contradiction is None:
            for each in (*self._chain.finished, solved):
                self._fuse(each)
        self._gaps.remember(solved)

    def _finished_by_regular_stamps(self) -> KeyframeStates | None:
        """All states by samples at a regular rate of images, if these contradict no more."""
        stamps_ns, found = self._tracked()[0], self._chain.agreement
        regular_ns = regular_stamps(stamps_ns)
        if regular_ns is None or self._chain.finished:
            return None
        self._chain.agreement = Agreement()
        self._chain.read_again(dict(zip(stamps_ns.tolist(), regular_ns.tolist(), strict=True)))
        solved = self._chain.finish()
        if self._chain.agreement.contradiction is None:
            self._stamp_sigma_s = 1e-9 * float((regular_ns - stamps_ns).std())
            return solved
        self._chain.agreement = found
        return None

    def _found_contradiction(self) -> str | None:
        """How sensor and images contradict each other, after the last frame."""
        reason, found = self._chain.reason, self._chain.agreement.contradiction
        if found is None and reason in WRONG and not self._chain.is_initialised:
            found = reason.value
        if found is None:
            return None
        stamps_ns, segments, rotations = self._tracked()
        half = len(stamps_ns) // 2
        offsets = [
            measure_time_offset(stamps_ns[part], segments[part], rotations[part], self._reader)
            for part in (slice(0, half), slice(half, None))
        ]
        return different_clocks(*offsets) or found

    @timed("inertial")
    def fill_gaps(self) -> None:
        """Give lost frames poses, after `finish`, and after the pose graph has placed keyframes."""
        solved = self._chain.newest
        if solved is not None and self._is_metric and not self._fused:
            self._join(solved)
        lost = self._gaps.bridged(None if self._is_metric else self.map_poses.metric_worlds)
        self._trajectory.store.add_inertial(lost + self._turns.turned(lost))

    @timed("inertial")
    def graph_poses(self) -> Mapping[int, InertialPose]:
        """Poses of keyframes, estimated together, for the pose graph that is optimised next.

        By id of the keyframe; those of one segment are in one frame.
        """
        if self._is_metric:
            return self._fused or self._joined_poses()
        solved = self._chain.smoothed()
        if solved is None:
            return self.map_poses.give(None, {}, (0.0, 0.0))
        covariance = solved.estimate.covariance
        sigma_scale = math.sqrt(float(covariance[:, LOG_SCALE, LOG_SCALE].min()))
        tilt = tilt_sigma(solved.estimate.states.rotation[-1], covariance[-1])
        estimated = self._estimated(solved)
        return self.map_poses.give(solved.world, estimated, (sigma_scale, tilt))

    def _set(self, keyframes: list[Keyframe]) -> None:
        before: Keyframe | None = None
        covariances: list[Floats | None] = [None, *motion_covariances(keyframes)]
        for keyframe, covariance in zip(keyframes, covariances, strict=False):
            if before is not None and covariance is not None:
                counted = self._predictor.in_windows.get((before.id, keyframe.id))
                # The samples are a measurement of the chain, too.
                if counted is not None and before.id in keyframe.cross_covariance:
                    covariance = without_inertial(covariance, counted.covariance)
            frame, pose = keyframe.frame, keyframe.world_from_cam.copy()
            place = keyframe.id, frame.index, frame.stamp_ns, frame.segment
            self._chain.set(Node(*place, pose, covariance))
            before = keyframe

    def _measure_offset(self) -> bool:
        """Measure the time offset with all frames; whether another one is used now."""
        return self._offset.measure(*self._tracked())

    def _tracked(self) -> tuple[Ints, Ints, Floats]:
        """Times, segments and rotations (n, 3, 3) of all tracked frames, by images alone."""
        store = self._trajectory.store
        tracked = store.frames["fraction"] == 0  # the others are interpolated
        path, segments = store.odometry(), store.frames["segment"]
        rotations = path.world_from_cam[:, :3, :3]
        return path.stamps_ns[tracked], segments[tracked], rotations[tracked]

    def _place(self, solved: KeyframeStates | None, *, keeps_earlier: bool = True) -> None:
        """Place the keyframes of a single camera in the metric, upright world."""
        if solved is not None and self._is_metric:
            self._join(solved)
        elif solved is not None:
            estimated = self._estimated(solved)
            self.map_poses.update(solved.world, estimated, keeps_earlier=keeps_earlier)

    def _estimated(self, solved: KeyframeStates) -> dict[int, EstimatedPose]:
        """The keyframes whose scale is certain enough, by id."""
        rows = certain(solved)
        states = solved.estimate.states
        world_from_imu = np.tile(np.eye(4), (len(rows), 1, 1))
        world_from_imu[:, :3, :4] = np.dstack([states.rotation[rows], states.position[rows]])
        pose, scale = world_from_imu @ self._imu_from_cam0, np.exp(states.log_scale[rows])
        covariance = self._covariance(solved, rows)
        result: dict[int, EstimatedPose] = {}
        for n, row in enumerate(rows):
            node = solved.nodes[row]
            result[node.keyframe] = EstimatedPose(
                node.frame_index,
                node.segment,
                solved.world,
                solved.origin,
                pose[n],
                float(scale[n]),
                covariance[n],
            )
        return result

    def _join(self, solved: KeyframeStates) -> None:
        """Place each later segment of a metric path by its motion since the one before.

        The path of each segment stays that of the images.
        """
        states, store = solved.estimate.states, self._trajectory.store
        for row in range(1, len(solved.nodes)):
            before, after = solved.nodes[row - 1], solved.nodes[row]
            if before.segment == after.segment:
                continue
            pose = np.tile(np.eye(4), (2, 1, 1))
            pose[:, :3, :3] = states.rotation[row - 1 : row + 1]
            pose[:, :3, 3] = states.position[row - 1 : row + 1]
            cam0 = pose @ self._imu_from_cam0
            motion = inverse(cam0[0]) @ cam0[1]
            world, first_from_before = self._joints.get(before.segment, (before.segment, np.eye(4)))
            rectified = self._trajectory.world_from_rectified(motion)
            first_from_after = first_from_before @ before.world_from_cam @ rectified
            self._joints[after.segment] = world, first_from_after @ inverse(after.world_from_cam)
            if self.map_poses.is_in_graph(after.segment):
                continue
            (reference,) = store.keyframes_by_id([before.keyframe])
            joined = reference.world_from_cam0 @ motion
            store.move_keyframes(
                np.array([after.keyframe], np.int64),
                np.array([store.world(before.segment)], np.int64),
                joined[None],
                np.ones(1),
                self._covariance(solved, [row]),
            )

    def _fuse(self, solved: KeyframeStates) -> None:
        """Place keyframes of a metric path by images and sensor together, after the last frame.

        The first one stays where it is. The sensor holds the vertical, and short turns.
        """
        states, nodes = solved.estimate.states, solved.nodes
        pose = np.tile(np.eye(4), (states.number, 1, 1))
        pose[:, :3, :3], pose[:, :3, 3] = states.rotation, states.position
        cam0 = pose @ self._imu_from_cam0
        rectified = self._trajectory.world_from_rectified(cam0)
        in_first = nodes[0].world_from_cam @ inverse(rectified[0]) @ rectified
        self._trajectory.store.metric.fused |= {node.segment for node in nodes}
        self.joint.placed.append(solved)
        ids = np.array([node.keyframe for node in nodes], np.int64)
        placed = zip(ids.tolist(), in_first, strict=True)
        self._fused.update((k, InertialPose(solved.world, each, 1.0)) for k, each in placed)
        if any(self.map_poses.is_in_graph(node.segment) for node in nodes):
            self.map_poses.awaits_graph = True
            return
        store = self._trajectory.store
        (first,) = store.keyframes_by_id([nodes[0].keyframe])
        store.move_keyframes(
            ids,
            np.full(len(ids), store.world(nodes[0].segment)),
            first.world_from_cam0 @ inverse(cam0[0]) @ cam0,
            np.ones(len(ids)),
            self._covariance(solved, list(range(len(ids)))),
        )

    def _joined_poses(self) -> Mapping[int, InertialPose]:
        """Poses of the keyframes of segments that were joined, in the frame of their first one."""
        worlds = {world for world, _ in self._joints.values()}
        frames = {world: (world, np.eye(4)) for world in worlds} | self._joints
        return {
            node.keyframe: InertialPose(
                frames[node.segment][0], frames[node.segment][1] @ node.world_from_cam, 1.0
            )
            for node in self._chain.nodes
            if node.segment in frames
        }

    def _known(self, solved: KeyframeStates, keyframes: list[Keyframe]) -> KnownMotion | None:
        """The motion at the newest keyframe of the local map; None while it is uncertain."""
        node, row = solved.nodes[-1], len(solved.nodes) - 1
        if node.keyframe != keyframes[-1].id or row not in certain(solved):
            return None
        states = solved.estimate.states.rows(slice(-1, None))
        return known_motion(node.stamp_ns, states, solved.estimate.covariance[-1])

    def _covariance(self, solved: KeyframeStates, rows: list[int]) -> Floats:
        """(n, 6, 6) of cam0's poses, tangent on the right."""
        covariance = solved.estimate.covariance[rows][:, :6, :6]
        return tangent_of_cam0(solved.estimate.states.rotation[rows], covariance, self._adjoint)

    def _states(self, solved: KeyframeStates) -> InertialStates:
        states, covariance = solved.estimate.states, solved.estimate.covariance[-1]
        covariance = covariance * self._chain.agreement.excess**2
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        to_path = self._path_from_upright(solved)
        return InertialStates(
            scale=math.exp(float(states.log_scale[-1])),
            scale_sigma=0.0 if self._is_metric else float(sigma[LOG_SCALE]),
            up=tuple(to_path[:, 2].tolist()),
            tilt_sigma_deg=math.degrees(tilt_sigma(states.rotation[-1], covariance)),
            velocity_m_s=tuple((to_path @ states.velocity[-1]).tolist()),
            gyro_bias_rad_s=tuple(states.gyro_bias[-1].tolist()),
            gyro_bias_sigma_rad_s=tuple(sigma[GYRO_BIAS].tolist()),
            accel_bias_m_s2=tuple(states.accel_bias[-1].tolist()),
            accel_bias_sigma_m_s2=tuple(sigma[ACCEL_BIAS].tolist()),
            misfit=solved.estimate.misfit,
        )

    def _path_from_upright(self, solved: KeyframeStates) -> Floats:
        """(3, 3) from the upright world to that of the path.

        They are one for a single camera, but for what the pose graph has changed.
        """
        if not self._is_metric:
            return self.map_poses.map_from_upright(solved.world)
        (pose,) = self._trajectory.store.keyframes_by_id([solved.nodes[-1].keyframe])
        path_from_imu = pose.world_from_cam0[:3, :3] @ self._imu_from_cam0[:3, :3].T
        return np.asarray(path_from_imu @ solved.estimate.states.rotation[-1].T)
