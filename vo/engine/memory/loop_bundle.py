"""Bundle adjustment of worlds with loops, at the end of a run with one camera.

The pose graph knows of the path between two loops only the covariance of its motions, which hides
how the scale has drifted. Here all observations of the keyframes are used again, with the loops as
measured motions. The landmarks of two visits stay apart: their relation is that of the loop. With
two cameras the pose graph alone is as accurate (docs/experiments/loop-verification.md).
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.config import SmoothingConfig
from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Floats, Floats32
from vo.engine.backend.loop_adjustment import (
    MAX_WIDTH,
    NO_MOTIONS,
    AdjustedPath,
    Motions,
    adjust_path,
    levels_by,
)
from vo.engine.backend.window_problem import WindowProblem
from vo.engine.mapping.keyframe import FrameId, Keyframe
from vo.engine.mapping.keyframe_store import StoredLandmarks
from vo.engine.places.records import Loop, PlaceKey, RegisteredKeyframes

_log = logging.getLogger(__name__)

_MAX_KEYFRAMES = 2000  # some twenty seconds for so many
_MAX_STORED = 20_000  # in all segments; each takes some 20 kB
_NEXT_CHECK = 1.2  # more keyframes after a check of what sees the same
_MAX_MORE_SCALE, _MIN_SCALE_ERROR = 1.5, 0.001  # of scales at loops, relative to the graph


class _Observations(NamedTuple):
    """What a keyframe observes; rows belong together.

    Attributes:
        xyz: (n, 3) landmarks in the frame of the keyframe.
        xy: (n, 2) ideal pixels.
        sigma_px: (n,) standard deviation of xy.
    """

    frame: FrameId
    landmark: NDArray[np.int32]
    xyz: Floats32
    xy: Floats32
    sigma_px: Floats32


class LoopBundle:
    """Keeps the observations of stored keyframes, and adjusts worlds with loops by them.

    Those of segments that are too large are not kept, nor those that the adjustment would refuse.
    """

    def __init__(self, intrinsics: Intrinsics, config: SmoothingConfig) -> None:
        self._intrinsics = intrinsics
        self._config = config
        self._stored: dict[PlaceKey, _Observations] = {}
        self._keyframes: Counter[int] = Counter()  # added, by segment
        self._next_check: dict[int, float] = {}  # that number of keyframes, by segment

    def add(self, key: PlaceKey, keyframe: Keyframe, landmarks: StoredLandmarks) -> None:
        """Keep what a keyframe observes."""
        segment = keyframe.frame.segment
        self._keyframes[segment] += 1
        if self._keyframes[segment] > _MAX_KEYFRAMES or len(self._stored) == _MAX_STORED:
            self._keep(lambda frame: frame.segment != segment)
            return
        order = np.argsort(keyframe.landmark, kind="stable")
        order = order[np.isin(keyframe.landmark[order], landmarks.id, assume_unique=True)]
        xyz = transform_points(inverse(keyframe.world_from_cam), landmarks.xyz)
        self._stored[key] = _Observations(
            keyframe.frame,
            landmarks.id.astype(np.int32),
            xyz.astype(np.float32),
            keyframe.xy[order].astype(np.float32),
            keyframe.sigma_px[order].astype(np.float32),
        )

    def forget_wide(self, segment: int, loops: Sequence[Loop]) -> None:
        """Forget a segment so many keyframes of which see the same that it will not be adjusted."""
        count = self._keyframes[segment]
        if not loops or not self._next_check.get(segment, MAX_WIDTH) < count <= _MAX_KEYFRAMES:
            return
        self._next_check[segment] = _NEXT_CHECK * count
        stored = {k: each for k, each in self._stored.items() if each.frame.segment == segment}
        ends = [(a, b) for a, b, _ in loops_inside(list(stored), loops)]
        point = np.unique(
            np.concatenate([each.landmark for each in stored.values()]), return_inverse=True
        )[1]
        width = levels_by(
            np.bincount(point) >= 2,
            point,
            np.repeat(np.arange(len(stored)), [len(each.landmark) for each in stored.values()]),
            len(stored),
            np.array(ends, np.int64).reshape(-1, 2),
        ).width
        if width > MAX_WIDTH:
            _log.warning("a path of which %d poses see the same will not be adjusted", width)
            self._keyframes[segment] = _MAX_KEYFRAMES
            self._keep(lambda frame: frame.segment != segment)

    def remove_from(self, frame_index: int) -> None:
        """Forget keyframes of a frame and those after it, which are tracked anew."""
        self._keep(lambda frame: frame.index < frame_index)

    def _keep(self, is_kept: Callable[[FrameId], bool]) -> None:
        self._stored = {k: each for k, each in self._stored.items() if is_kept(each.frame)}

    def adjusted(
        self, registered: RegisteredKeyframes, loops: Sequence[Loop]
    ) -> RegisteredKeyframes | None:
        """The keyframes of a world after the adjustment; None where it cannot be done.

        It is refused where it contradicts the scales that loops have measured, which it does not
        use, more than the pose graph does. The first one stays where it is, and the path keeps its
        length. Covariances stay as they are.

        Args:
            registered: all keyframes of the world that were stored, in order.
            loops: that the pose graph accepts; those of other worlds are ignored.
        """
        stored = self._observations(registered.keys)
        scale, inside = registered.scale, loops_inside(registered.keys, loops)
        if stored is None or not inside:
            return None
        problem = self._problem(stored, registered.world_from_cam, scale)
        found = adjust_path(problem, measured_motions(inside, scale), self._config)
        if found is None:
            return None
        before = np.concatenate([s * each.xyz[:, 2] for s, each in zip(scale, stored, strict=True)])
        return with_scale_kept(registered, problem, found, before, inside)

    def _observations(self, keys: Sequence[PlaceKey]) -> list[_Observations] | None:
        """Observations of all keyframes of a world; None where there are too many, or none."""
        if len(keys) > _MAX_KEYFRAMES or any(key not in self._stored for key in keys):
            return None
        return [self._stored[key] for key in keys]

    def _problem(
        self,
        stored: Sequence[_Observations],
        world_from_cam: Floats,
        scale: Floats,
    ) -> WindowProblem:
        xyz = [
            transform_points(pose, unit * each.xyz.astype(np.float64))
            for pose, unit, each in zip(world_from_cam, scale.tolist(), stored, strict=True)
        ]
        landmark = np.concatenate([each.landmark for each in stored])
        # A landmark starts where the last keyframe that observes it has it.
        last, point = np.unique(landmark[::-1], return_index=True, return_inverse=True)[1:]
        return WindowProblem(
            intrinsics=self._intrinsics,
            baseline_m=0.0,
            sigma_disparity_px=1.0,  # of none
            world_from_cam=world_from_cam,
            fixed=np.arange(len(stored)) == 0,
            points=np.concatenate(xyz)[::-1][last],
            keyframe=np.repeat(np.arange(len(stored)), [len(each.landmark) for each in stored]),
            point=np.ascontiguousarray(point[::-1]),
            xy=np.concatenate([each.xy for each in stored]).astype(np.float64),
            disparity=np.full(len(landmark), np.nan),
            sigma_px=np.concatenate([each.sigma_px for each in stored]).astype(np.float64),
            estimates_calibration=False,
        )


def loops_inside(keys: Sequence[PlaceKey], loops: Sequence[Loop]) -> list[tuple[int, int, Loop]]:
    """Rows of the earlier and the later keyframe of loops, of those that have both."""
    row = {key: n for n, key in enumerate(keys)}
    ends = [(row.get(loop.earlier), row.get(loop.later), loop) for loop in loops]
    return [(a, b, loop) for a, b, loop in ends if a is not None and b is not None]


def measured_motions(loops: Sequence[tuple[int, int, Loop]], scale: Floats) -> Motions:
    """Those of loops, in the unit of the world; none without loops."""
    motions = [_motion(loop, a, b, scale[a], scale[b]) for a, b, loop in loops]
    if not motions:
        return NO_MOTIONS
    return Motions(*(np.array(each) for each in zip(*motions, strict=True)))


def with_scale_kept(
    registered: RegisteredKeyframes,
    problem: WindowProblem,
    found: AdjustedPath,
    before: Floats,
    loops: Sequence[tuple[int, int, Loop]],
) -> RegisteredKeyframes | None:
    """Adjusted keyframes of one camera, whose path keeps its length.

    None where they contradict the scales of loops more than the pose graph does. `before`: (N,)
    depths of the problem's observations.
    """
    world_from_cam = found.world_from_cam.copy()
    unit = _length(problem.world_from_cam) / _length(world_from_cam)
    first = world_from_cam[0, :3, 3].copy()
    world_from_cam[:, :3, 3] = first + unit * (world_from_cam[:, :3, 3] - first)
    scale = registered.scale * unit * _depth_ratios(problem, found, before)
    if loops:
        allowed = max(_MAX_MORE_SCALE * _scale_error(registered.scale, loops), _MIN_SCALE_ERROR)
        if _scale_error(scale, loops) > allowed:
            return None
    return replace(registered, world_from_cam=world_from_cam, scale=scale)


def _motion(
    loop: Loop, earlier: int, later: int, earlier_scale: float, later_scale: float
) -> tuple[int, int, Floats, Floats]:
    """The row of a loop in `Motions`, in the unit of the world."""
    motion = loop.earlier_from_later.copy()
    motion[:3, 3] *= earlier_scale
    unit = np.r_[np.ones(3), np.full(3, later_scale)]
    return earlier, later, motion, unit[:, None] * loop.covariance[:6, :6] * unit


def _scale_error(scale: Floats, loops: Sequence[tuple[int, int, Loop]]) -> float:
    """Root mean square difference from the logarithms of the scales that loops have measured."""
    errors = [np.log(scale[b] / scale[a] / loop.scale) for a, b, loop in loops]
    return float(np.sqrt(np.mean(np.square(errors))))


def _length(world_from_cam: Floats) -> float:
    """Of the path through keyframes (K, 4, 4)."""
    return float(np.linalg.norm(np.diff(world_from_cam[:, :3, 3], axis=0), axis=1).sum())


def _depth_ratios(problem: WindowProblem, found: AdjustedPath, before: Floats) -> Floats:
    """(K,) depths of each keyframe's landmarks relative to those of before (N,), the median."""
    pose = found.world_from_cam[problem.keyframe]
    offset = found.points[problem.point] - pose[:, :3, 3]
    after = np.einsum("ni,ni->n", pose[:, :3, 2], offset)
    usable = (before > 0) & (after > 0)
    ratio = np.ones(len(found.world_from_cam))
    for k in range(len(ratio)):
        rows = np.flatnonzero(usable & (problem.keyframe == k))
        if len(rows):
            ratio[k] = np.median(after[rows] / before[rows])
    return ratio
