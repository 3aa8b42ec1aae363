"""Poses of lost frames by the inertial sensor, between frames that were tracked."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import adjoint, inverse
from vo.base.types import Floats, ImuNoise, Ints, KeyframePose
from vo.engine.inertial.bridging import EndState, bridge, moved_to
from vo.engine.inertial.keyframe_states import KeyframeStates
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import ACCEL_BIAS, POSITION, VELOCITY
from vo.engine.trajectory.builder import TrajectoryBuilder
from vo.engine.trajectory.inertial_frames import InertialFrame, with_reference

MAX_GAP_S = 5.0  # as between segments that are joined
_MOTION = slice(VELOCITY.start, ACCEL_BIAS.stop)


class _KeyframeState(NamedTuple):
    """Newest states of a keyframe: rotation and velocity in an upright world of the time."""

    frame_index: int
    stamp_ns: int
    world_from_imu: Floats
    velocity: Floats
    gyro_bias: Floats
    accel_bias: Floats
    covariance: Floats  # (9, 9) of velocity and biases


class _End(NamedTuple):
    """A tracked frame beside a gap, in the world of the path."""

    stamp_ns: int
    path_from_cam0: Floats


class InertialGaps:
    """Remembers states of keyframes, and bridges the gaps beside them after the last frame."""

    def __init__(
        self,
        trajectory: TrajectoryBuilder,
        reader: SampleReader,
        noise: ImuNoise,
        cam0_from_imu: Floats,
    ) -> None:
        self._trajectory, self._reader, self._noise = trajectory, reader, noise
        self._cam0_from_imu, self._imu_from_cam0 = cam0_from_imu, inverse(cam0_from_imu)
        self._adjoint = adjoint(cam0_from_imu)
        self._states: dict[int, _KeyframeState] = {}  # by id of the keyframe

    def remember(self, solved: KeyframeStates | None) -> None:
        """Keep the states of keyframes, instead of older ones."""
        if solved is None:
            return
        states, covariance = solved.estimate.states, solved.estimate.covariance
        for row, node in enumerate(solved.nodes):
            self._states[node.keyframe] = _KeyframeState(
                node.frame_index,
                node.stamp_ns,
                states.rotation[row],
                states.velocity[row],
                states.gyro_bias[row],
                states.accel_bias[row],
                covariance[row, _MOTION, _MOTION],
            )

    def forget_from(self, frame_index: int) -> None:
        """Forget the keyframes from a frame on."""
        self._states = {k: s for k, s in self._states.items() if s.frame_index < frame_index}

    def bridged(self, worlds: Collection[int] | None) -> list[InertialFrame]:
        """Lost frames in gaps of up to `MAX_GAP_S`, in all worlds or in those given, in metres."""
        store, reached = self._trajectory.store, self._trajectory.reached
        frames = store.frames
        if len(frames) < 2 or not self._states:
            return []
        gaps = np.flatnonzero(
            np.diff(np.searchsorted(reached["frame_index"], frames["frame_index"])) > 1
        )
        added: list[InertialFrame] = []
        poses = store.trajectory().world_from_cam
        for row in gaps.tolist():
            segments = frames["segment"][[row, row + 1]].tolist()
            world, after = (store.world(number) for number in segments)
            if world != after or (worlds is not None and world not in worlds):
                continue
            ends = [_End(int(frames["stamp_ns"][k]), poses[k]) for k in (row, row + 1)]
            if ends[1].stamp_ns - ends[0].stamp_ns > MAX_GAP_S * 1e9:
                continue
            begin, end = np.searchsorted(
                reached["frame_index"], frames["frame_index"][[row, row + 1]]
            )
            between = reached[begin + 1 : end]
            found = self._bridged(ends[0], ends[1], between["stamp_ns"])
            if found is None:
                continue
            keyframe = int(frames["keyframe"][row])
            (reference,) = store.keyframes_by_id([keyframe])
            covariance = _with_reference(found[1], found[0], reference)
            for k, (index, stamp_ns) in enumerate(between.tolist()):
                frame = (keyframe, index, stamp_ns, segments[0], found[0][k], covariance[k])
                added.append(InertialFrame(*frame))
        return added

    def _bridged(self, before: _End, after: _End, stamps_ns: Ints) -> tuple[Floats, Floats] | None:
        """Poses (n, 4, 4) of cam0 in the path and their covariance relative to both ends."""
        ids = sorted(self._states)
        stamps = [self._states[k].stamp_ns for k in ids]
        k = bisect_right(stamps, before.stamp_ns) - 1
        if k < 0 or before.stamp_ns - stamps[k] > MAX_GAP_S * 1e9:
            return None
        upright = np.eye(4)
        upright[:3, :3] = self._upright_from_path(ids[k])
        first = self._end(before, ids[k], upright)
        if first is None:
            return None
        k = bisect_left(stamps, after.stamp_ns)
        last = None
        if k < len(ids) and stamps[k] - after.stamp_ns <= MAX_GAP_S * 1e9:
            last = self._end(after, ids[k], upright)
        if last is None:
            pose = upright @ after.path_from_cam0 @ self._cam0_from_imu
            last = first._replace(stamp_ns=after.stamp_ns, world_from_imu=pose, velocity=None)
        found = bridge(first, last, stamps_ns, self._reader, self._noise)
        if found is None:
            return None
        poses = inverse(upright) @ found.world_from_imu @ self._imu_from_cam0
        return poses, tangent_of_cam0(found.world_from_imu, found.covariance, self._adjoint)

    def _upright_from_path(self, keyframe: int) -> Floats:
        """(3, 3) by the states of a keyframe."""
        return np.asarray(self._states[keyframe].world_from_imu @ self._path_from_imu(keyframe).T)

    def _path_from_imu(self, keyframe: int) -> Floats:
        (pose,) = self._trajectory.store.keyframes_by_id([keyframe])
        return np.asarray(pose.world_from_cam0[:3, :3] @ self._cam0_from_imu[:3, :3])

    def _end(self, end: _End, keyframe: int, upright: Floats) -> EndState | None:
        """A frame with the velocity that a keyframe beside it has; None without samples."""
        state = self._states[keyframe]
        (pose,) = self._trajectory.store.keyframes_by_id([keyframe])
        to_upright = upright[:3, :3] @ self._path_from_imu(keyframe) @ state.world_from_imu.T
        turn = np.eye(9)
        turn[:3, :3] = to_upright
        known = EndState(
            state.stamp_ns,
            upright @ pose.world_from_cam0 @ self._cam0_from_imu,
            to_upright @ state.velocity,
            state.gyro_bias,
            state.accel_bias,
            turn @ state.covariance @ turn.T,
        )
        at_frame = known._replace(
            stamp_ns=end.stamp_ns,
            world_from_imu=upright @ end.path_from_cam0 @ self._cam0_from_imu,
        )
        return moved_to(known, at_frame, self._reader, self._noise)


def tangent_of_cam0(world_from_imu: Floats, covariance: Floats, cam0_adjoint: Floats) -> Floats:
    """Covariances (n, 6, 6) of cam0's poses, tangent on the right, rotation first.

    Args:
        world_from_imu: (n, 4, 4) or (n, 3, 3).
        covariance: (n, 6, 6) of the sensor's rotation, tangent on the right, and of its position
            in the world.
        cam0_adjoint: (6, 6) that of cam0_from_imu.
    """
    turn = np.tile(np.eye(6), (len(covariance), 1, 1))
    turn[:, POSITION, POSITION] = np.swapaxes(world_from_imu[:, :3, :3], 1, 2)
    to_cam = cam0_adjoint @ turn
    return np.asarray(to_cam @ covariance @ np.swapaxes(to_cam, 1, 2))


def _with_reference(
    covariance: Floats, path_from_cam0: Floats, reference: KeyframePose
) -> list[Floats | None]:
    """Covariances with that of the keyframe before the gap; None where that is unknown."""
    if reference.covariance is None:
        return [None] * len(covariance)
    return list(with_reference(covariance, path_from_cam0, reference))
