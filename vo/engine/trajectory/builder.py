"""The trajectory of a run, built from the keyframes of the local map."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo.base.geometry.transforms import adjoint, inverse
from vo.base.types import Floats, KeyframePose, PredictedPose
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.keyframe import FrameId, Keyframe
from vo.engine.places.records import PlaceKey, RegisteredKeyframes
from vo.engine.tracking.motion_model import PosePrior
from vo.engine.trajectory.inertial_frames import with_reference
from vo.engine.trajectory.map_frame import Anchor, scaled_covariance
from vo.engine.trajectory.store import TrajectoryStore
from vo.engine.trajectory.table import Table

_REACHED = np.dtype([("frame_index", np.int64), ("stamp_ns", np.int64)])


class TrajectoryBuilder:
    """Converts poses of the rectified camera to poses of the recorded cam0 and stores them.

    The world frame of the result is cam0 at its first pose: the odometry frame, until the pose
    graph has placed keyframes of the segment in the map frame.
    """

    def __init__(self, cam0_from_rectified: Floats, *, is_metric: bool = False) -> None:
        self.store = TrajectoryStore(is_metric=is_metric)
        self._reached = Table(_REACHED)
        self.cam0_from_rectified = cam0_from_rectified
        self._rectified_from_cam0 = inverse(cam0_from_rectified)
        self._adjoint = adjoint(cam0_from_rectified)

    @property
    def reached(self) -> NDArray[Any]:
        """(n,) rows with `frame_index` and `stamp_ns` of all frames, those without a pose too."""
        return self._reached.rows

    def reach(self, frame: PreprocessedFrame) -> None:
        """Remember the time of a frame, whatever becomes of it."""
        if len(self._reached) == 0 or frame.index > self.reached["frame_index"][-1]:
            self._reached.append(frame.index, frame.stamp_ns)

    def add_frame(
        self, frame: PreprocessedFrame | FrameId, keyframe: Keyframe, world_from_cam: Floats
    ) -> None:
        """Add a frame with its pose (4, 4), relative to a keyframe that is stored already."""
        segment, pose = keyframe.frame.segment, self.world_from_cam0(world_from_cam)
        self.store.add(frame.index, frame.stamp_ns, segment, keyframe.id, pose)

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Store a new keyframe, and add its frame."""
        self.update([keyframe])
        if self._has_tracked_since(keyframe.frame):
            self.store.connect(keyframe.id)
        frame, pose = keyframe.frame, self.world_from_cam0(keyframe.world_from_cam)
        self.store.add(frame.index, frame.stamp_ns, frame.segment, keyframe.id, pose)

    def measure(self, frames: Sequence[int], keyframe_from_cam: Floats) -> None:
        """Replace what frames measured since a keyframe, see `TrajectoryStore.measure`."""
        self.store.measure(frames, self.world_from_cam0(keyframe_from_cam))

    def odometry(self) -> Floats:
        """Poses (n, 4, 4) of the rectified camera at all frames before loops, by segment."""
        return self.world_from_rectified(self.store.odometry().world_from_cam)

    def _has_tracked_since(self, frame: FrameId) -> bool:
        """Whether all frames since the keyframe before have a pose in its segment."""
        rows = self.store.frames
        if len(rows) == 0 or rows["segment"][-1] != frame.segment:
            return False
        first = bisect_left(rows["keyframe"], rows["keyframe"][-1])
        between = (rows["frame_index"][first], frame.index)
        begin, end = np.searchsorted(self.reached["frame_index"], between)
        return bool(end - begin == np.count_nonzero(rows["fraction"][first:] == 0))

    def update(self, keyframes: Sequence[Keyframe]) -> None:
        """Store new poses and covariances of keyframes."""
        if not keyframes:
            return
        poses = self.world_from_cam0(np.array([k.world_from_cam for k in keyframes]))
        stored = []
        for keyframe, pose in zip(keyframes, poses, strict=True):
            covariance = keyframe.covariance
            if covariance is not None:
                covariance = self._adjoint @ covariance @ self._adjoint.T
            frame = keyframe.frame
            place = frame.index, frame.stamp_ns, frame.segment
            stored.append(KeyframePose(*place, pose, covariance))
        self.store.store_all([k.id for k in keyframes], stored)

    def remove_from(self, frame_index: int) -> Floats | None:
        """Remove a frame and all after it; the pose (4, 4) of the first, None without any."""
        pose = self.store.remove_from(frame_index)
        if pose is None:
            return None
        return self.world_from_rectified(pose)

    def take_moved(self) -> tuple[KeyframePose, ...]:
        """Keyframes that were added or moved since the last call."""
        return self.store.take_moved()

    def map_from_cam0(self, odom_from_rectified: Floats, anchor: Anchor | None) -> Floats:
        """Pose (4, 4) of the recorded cam0 in the map frame, where an anchor has placed it."""
        pose = self.world_from_cam0(odom_from_rectified)
        return pose if anchor is None else anchor.transform(pose)

    def predicted(
        self, prior: Floats | PosePrior | None, segment: int, anchor: Anchor | None
    ) -> PredictedPose | None:
        """A predicted pose in the map frame; the prior, or pose alone, is in that of odometry."""
        if prior is None:
            return None
        if not isinstance(prior, PosePrior):
            return PredictedPose(self.map_from_cam0(prior, anchor), None)
        pose = self.map_from_cam0(prior.world_from_cam, anchor)
        reference = self.store.newest_certain(segment)
        if reference is None:
            return PredictedPose(pose, None)
        covariance = self._adjoint @ prior.covariance @ self._adjoint.T
        if anchor is not None:
            covariance = scaled_covariance(covariance, anchor.scale)
        return PredictedPose(pose, with_reference(covariance, pose, reference))

    def move_keyframes(self, registered: RegisteredKeyframes, session: int) -> None:
        """Place the keyframes of a session in the map frame; the frames relative to them follow."""
        rows = [n for n, key in enumerate(registered.keys) if key.session == session]
        if not rows:
            return
        rows.sort(key=lambda n: registered.keys[n].keyframe)
        # The map frame is that of a rectified camera, as the odometry frame is.
        covariance = self._adjoint @ registered.covariance[rows] @ self._adjoint.T
        self.store.move_keyframes(
            np.array([registered.keys[n].keyframe for n in rows], np.int64),
            registered.world[rows],
            self.world_from_cam0(registered.world_from_cam[rows]),
            registered.scale[rows],
            covariance,
        )

    def world_from_rectified(self, world_from_cam0: Floats) -> Floats:
        """The inverse of `world_from_cam0`."""
        return np.asarray(self._rectified_from_cam0 @ world_from_cam0 @ self.cam0_from_rectified)

    def registered(self, world: int, session: int) -> RegisteredKeyframes:
        """The keyframes of a world of the run, as for `move_keyframes`."""
        ids, world_from_cam0, scale, covariance = self.store.registered(world)
        to_rectified = adjoint(self._rectified_from_cam0)
        return RegisteredKeyframes(
            tuple(PlaceKey(session, number) for number in ids.tolist()),
            np.full(len(ids), world, np.int64),
            self.world_from_rectified(world_from_cam0),
            scale,
            to_rectified @ covariance @ to_rectified.T,
            (),
        )

    def world_from_cam0(self, world_from_rectified: Floats) -> Floats:
        """Poses (..., 4, 4) of the recorded cam0."""
        return np.asarray(
            self.cam0_from_rectified @ world_from_rectified @ self._rectified_from_cam0
        )
