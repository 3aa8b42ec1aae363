"""A window of keyframes to be optimised: poses, landmarks, observations and further factors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from vo.base.frozen import frozen
from vo.base.geometry.projection import Intrinsics
from vo.base.types import Bools, Floats, Ints

if TYPE_CHECKING:
    import gtsam

    from vo.engine.mapping.keyframe import Keyframe


class WindowFactor(Protocol):
    """A factor between the poses of a window, and perhaps further states, beside the observations.

    Nothing may change it, because windows are optimised in another thread.
    """

    def add_to(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        pose_key: Callable[[int], int],
    ) -> None:
        """Add GTSAM factors, and initial values of further states that are not there yet.

        Args:
            graph: receives the factors.
            values: receives the states; it holds a `gtsam.Pose3` (world_from_cam) of every pose.
                Keys of further states are made by `gtsam.symbol`, with a character of their own.
            pose_key: key of a pose by its row in `WindowProblem.world_from_cam`.
        """
        ...


class FactorSource(Protocol):
    """Gives the factors of each window, such as inertial ones, and receives their states."""

    def factors(self, keyframes: Sequence[Keyframe]) -> Sequence[WindowFactor]:
        """Factors between these keyframes, whose order is that of the window's poses."""
        ...

    def update(self, keyframes: Sequence[Keyframe], states: dict[int, Floats]) -> None:
        """Receive the optimised states by key, after the keyframes were moved."""
        ...


@frozen(eq=False)
class WindowProblem:
    """A window of K poses, M points, N observations and further factors.

    Attributes:
        baseline_m: distance to the right camera, 0 in mono.
        world_from_cam: (K, 4, 4) first guess.
        fixed: (K,) poses that stay where they are.
        points: (M, 3) in the world.
        keyframe: (N,) row in world_from_cam of each observation.
        point: (N,) row in points of each observation.
        xy: (N, 2) ideal pixels.
        disparity: (N,) pixels, NaN without a measurement.
        sigma_px: (N,) standard deviation of xy.
        is_fixed_known: whether the fixed poses have covariances: information on them alone is not
            needed.
    """

    intrinsics: Intrinsics
    baseline_m: float
    sigma_disparity_px: float
    world_from_cam: Floats
    fixed: Bools
    points: Floats
    keyframe: Ints
    point: Ints
    xy: Floats
    disparity: Floats
    sigma_px: Floats
    estimates_calibration: bool = True
    factors: tuple[WindowFactor, ...] = ()
    ties: Ties | None = None
    is_fixed_known: bool = False

    def select(self, chosen: Ints) -> WindowProblem:
        """The same with some of the observations, in this order."""
        names = ("keyframe", "point", "xy", "disparity", "sigma_px")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})


class Ties(NamedTuple):
    """How the K poses of a window are views of B poses of a rig, V of each, one after the other.

    Attributes:
        body_from_view: (K, 4, 4).
        lever: (K, 3) change of their translations with the length of a metre in the map, where
            that is unknown; None where it is known.
        lever_information: on that length, from earlier windows.
        cameras: (V,) camera of each view, where the extrinsics are estimated; else None.
    """

    body_from_view: Floats
    views: int
    lever: Floats | None = None
    lever_information: float = 0.0
    cameras: Ints | None = None


class Gauge(NamedTuple):
    """The gauge freedom that is fixed in a window of K poses, of which (K,) are held.

    Attributes:
        scaled: pose with a loose prior that keeps the scale of a mono window, or None.
        sigmas: (6,) standard deviations of that prior, in the tangent of the pose.
    """

    held: Bools
    scaled: int | None
    sigmas: Floats


def gauge_of(problem: WindowProblem) -> Gauge:
    """The fixed poses, in a window without any the first one; in mono also the scale."""
    held, poses = problem.fixed.copy(), problem.world_from_cam
    if not held.any():
        held[0] = True
    nothing = Gauge(held, None, np.full(6, np.inf))
    if problem.fixed.sum() >= 2 or problem.baseline_m > 0.0 or len(poses) < 2:
        return nothing
    anchor = int(np.flatnonzero(held)[0])
    distance = np.linalg.norm(poses[:, :3, 3] - poses[anchor, :3, 3], axis=1)
    farthest = int(np.argmax(distance))
    if farthest == anchor:
        return nothing
    length = float(distance[farthest])
    return Gauge(held, farthest, np.r_[np.full(3, 1.0), np.full(3, 0.02 * length)])
