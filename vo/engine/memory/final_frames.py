"""Frames between keyframes, by the landmarks of a path that was adjusted as a whole."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from vo.base.geometry.projection import PixelObservations
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse
from vo.base.types import Bytes, Floats, Ints
from vo.engine.frontend.patch_alignment import PatchAligner
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.pnp import refine_pose
from vo.engine.mapping.keyframe import FrameId, Keyframe
from vo.engine.mapping.tracked_frame import TrackedFrame
from vo.engine.memory.rematching import PathViews, References, found_in
from vo.engine.trajectory.builder import TrajectoryBuilder

_MAX_BYTES = 1_000_000_000  # of images
_MIN_FOUND = 100  # landmarks that agree with a pose


class AdjustedViews(NamedTuple):
    """A path that was adjusted.

    Attributes:
        keyframes: (K,) frames of the keyframes.
        unit: (K,) lengths in it of one unit of each keyframe's odometry.
        of_landmarks: the patches by which they were searched last.
    """

    views: PathViews
    rig: RectifiedRig
    keyframes: list[FrameId]
    unit: Floats
    of_landmarks: References


class _Frame(NamedTuple):
    """A frame between two keyframes."""

    frame_index: int
    image: Bytes
    mask: Bytes | None
    keyframe_from_cam: Floats  # (4, 4) as it was tracked


class FinalFrames:
    """Keeps the images of frames between keyframes, and searches landmarks in them at the end.

    What tracking found in them does not fit the landmarks any more: their patches are others.
    """

    def __init__(self, trajectory: TrajectoryBuilder, patches: PatchAligner, gate: float) -> None:
        self._trajectory, self._patches, self._gate = trajectory, patches, gate
        self._frames: dict[int, list[_Frame]] = {}  # by frame of the keyframe before them
        self._bytes = 0

    def see(self, frame: PreprocessedFrame, tracked: TrackedFrame, newest: Keyframe) -> None:
        """Keep a frame after the newest keyframe."""
        if self._bytes > _MAX_BYTES and newest.frame.index not in self._frames:
            return
        image, motion = frame.image0, inverse(newest.world_from_cam) @ tracked.world_from_cam
        self._bytes += image.nbytes
        kept = _Frame(frame.index, image.copy(), frame.masks[0], motion)
        self._frames.setdefault(newest.frame.index, []).append(kept)

    def forget_from(self, frame_index: int) -> None:
        """Forget a frame and all after it, which are tracked anew."""
        for keyframe, frames in self._frames.items():
            self._frames[keyframe] = [each for each in frames if each.frame_index < frame_index]

    def fit(self, path: AdjustedViews) -> None:
        """Fit the frames of a path, whose keyframes are placed already.

        Those after the last keyframe of a segment, which fewer landmarks hold, stay as they are.
        """
        poses, point = path.views.world_from_cam, path.views.point
        begin = np.searchsorted(path.views.keyframe, np.arange(len(poses) + 1))
        for k, (before, after) in enumerate(pairwise(path.keyframes)):
            frames = self._frames.get(before.index, [])
            if not frames or before.segment != after.segment:
                continue
            near = np.unique(point[begin[k] : begin[k + 2]])
            fitted = [self._fitted(frame, k, path, near) for frame in frames]
            motions = [motion for motion in fitted if motion is not None]
            if len(motions) < len(frames):
                continue
            numbers = [*(frame.frame_index for frame in frames), after.index]
            motion = np.stack([*motions, inverse(poses[k]) @ poses[k + 1]])
            motion[:, :3, 3] /= path.unit[k]
            self._trajectory.measure(numbers, motion)

    def _fitted(self, frame: _Frame, k: int, path: AdjustedViews, near: Ints) -> Floats | None:
        """keyframe_from_cam in lengths of the path; None where too little of `near` is found."""
        views, rig, motion = path.views, path.rig, frame.keyframe_from_cam.copy()
        motion[:3, 3] *= path.unit[k]
        pose = views.world_from_cam[k] @ motion
        place = pose, frame.image, frame.mask
        rows, xy, sigma_px = found_in(views, near, place, path.of_landmarks, rig, self._patches)
        if len(rows) < _MIN_FOUND:
            return None
        nothing = np.full(len(rows), np.nan)
        fit = refine_pose(
            inverse(pose),
            views.points[rows],
            PixelObservations(rig.undistort(xy), nothing, sigma_px, 1.0),
            rig.intrinsics,
            0.0,
            gate=self._gate,
        )
        if np.count_nonzero(fit.inlier) < _MIN_FOUND:
            return None
        return inverse(views.world_from_cam[k]) @ inverse(fit.cam_from_world)
