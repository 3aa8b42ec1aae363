"""Motions by an inertial sensor between keyframes with lost frames between them, in the window."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

from vo.base.frozen import frozen
from vo.base.types import Floats
from vo.engine.backend.window_problem import WindowFactor
from vo.engine.inertial.prediction import Gap, InertialPredictor, RelativeMotion
from vo.engine.mapping.keyframe import Keyframe

if TYPE_CHECKING:
    import gtsam


class _Gaps(Protocol):
    @property
    def gaps(self) -> Sequence[Gap]: ...


@frozen(eq=False)
class MotionFactor:
    """A measured motion between two rows of the poses of a window."""

    first: int
    second: int
    motion: RelativeMotion

    def add_to(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        pose_key: Callable[[int], int],
    ) -> None:
        """Add the factor."""
        import gtsam

        noise = gtsam.noiseModel.Gaussian.Covariance(self.motion.covariance)
        pose = gtsam.Pose3(self.motion.first_from_last)
        keys = pose_key(self.first), pose_key(self.second)
        graph.add(gtsam.BetweenFactorPose3(*keys, pose, noise))


class GapFactors:
    """Gives the factors of the gaps between the keyframes of a window.

    After a gap few landmarks of the map may be left in view, and in one corner of the image, so
    that they alone determine the pose badly. The predictor gets the motions that windows contain.
    """

    def __init__(self, motion: _Gaps, predictor: InertialPredictor) -> None:
        self._motion, self._predictor = motion, predictor

    def factors(self, keyframes: Sequence[Keyframe]) -> list[WindowFactor]:
        """Factors between keyframes before and after a gap."""
        gaps = self._motion.gaps
        if not gaps:
            return []
        return [
            MotionFactor(row, row + 1, motion)
            for row in range(len(keyframes) - 1)
            for motion in [self._motion_between(keyframes[row], keyframes[row + 1], gaps)]
            if motion is not None
        ]

    def update(self, keyframes: Sequence[Keyframe], states: dict[int, Floats]) -> None:
        """Nothing to receive."""

    def _motion_between(
        self, first: Keyframe, second: Keyframe, gaps: Sequence[Gap]
    ) -> RelativeMotion | None:
        times = first.frame.stamp_ns, second.frame.stamp_ns
        between = [g for g in gaps if times[0] <= g.first_ns and g.last_ns <= times[1]]
        if not between:
            return None
        key, measured = (first.id, second.id), self._predictor.in_windows
        if key not in measured:
            measured[key] = self._predictor.motion(between[0].known, *times)
        return measured[key]
