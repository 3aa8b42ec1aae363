"""Bundle adjustment as a function of the poses alone, with every point at its optimum.

For given poses each point is placed at the minimum of its robust cost, so that the cost is a
function of the poses, and its normal equations are those of the window with the points eliminated.
Given the poses, points are independent, which makes this a sum over points.

Source: Carlone et al., "Eliminating Conditionally Independent Sets in Factor Graphs", 2014 (smart
factors); Golub and Pereyra, "The Differentiation of Pseudo-Inverses", 1973 (variable projection).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.config import SmoothingConfig
from vo.base.geometry.projection import PixelObservations
from vo.base.geometry.transforms import inverse
from vo.base.types import Bools, Floats
from vo.engine.backend import block_kernels
from vo.engine.backend.path_equations import Levels, PathEquations
from vo.engine.backend.window_problem import WindowProblem
from vo.engine.geometry.points import PointViews, best_points, point_views

# Standard deviations from which an observation weighs less where errors of the lens are estimated:
# these are largest at the edges of images, where the window's threshold would hide them.
_LENS_HUBER = 1.0


class NormalEquations(NamedTuple):
    """hessian (6 F, 6 F) @ step = -gradient (6 F,), F free poses; cost: half the robust sum."""

    hessian: Floats
    gradient: Floats
    cost: float


class Bundle:
    """Observations of a window's points, and the points at the last linearisation.

    The tangent of a pose is (rx ry rz tx ty tz) in the camera's own frame.

    Attributes:
        views: the observations, by point, then keyframe.
        calibration_size: number of parameters of the calibration residual.
        check_size: number of further parameters, which show errors that those cannot explain.
    """

    def __init__(self, problem: WindowProblem, point_ok: Bools, config: SmoothingConfig) -> None:
        self._points = np.ascontiguousarray(problem.points)
        self._latest: _Optimum | None = None
        self.views = views_of(problem, point_ok, config)
        self._slot = np.where(problem.fixed, -1, np.cumsum(~problem.fixed) - 1)
        self._config = config
        self.calibration_size, self.check_size = (2 if problem.baseline_m > 0.0 else 1), 1

    def cost(self, world_from_cam: Floats) -> float:
        """Half the robust sum of squares for poses (K, 4, 4), every point at its optimum."""
        return self._at(world_from_cam).cost

    def points_for(self, world_from_cam: Floats) -> Floats:
        """(M, 3) optimal points for poses (K, 4, 4)."""
        return self._at(world_from_cam).points

    def normal_equations(
        self, world_from_cam: Floats, *, with_calibration: bool = False
    ) -> NormalEquations:
        """Linearise at poses (K, 4, 4) and their points, where later searches for points start.

        `with_calibration` appends the rows of the `CalibrationResidual`, linearised at 0.
        """
        at, poses, views = self._linearised_at(world_from_cam, with_calibration)
        hessian, gradient = block_kernels.reduced(
            at.points, poses, self._slot, with_calibration, views
        )
        size = 6 * (self._slot.max() + 1)
        if with_calibration:
            size += self.calibration_size + self.check_size
        return NormalEquations(hessian[:size, :size], gradient[:size], at.cost)

    def path_equations(
        self, world_from_cam: Floats, levels: Levels, *, with_calibration: bool = False
    ) -> tuple[PathEquations, Floats]:
        """The same of all poses (K, 4, 4), the fixed ones too, in the order of levels; gradient."""
        at, poses, views = self._linearised_at(world_from_cam, with_calibration)
        count = len(poses) + with_calibration
        layout = levels.row[:count], levels.end[:count]
        slot = np.arange(len(poses))
        flat, gradient = block_kernels.reduced_blocks(
            at.points, poses, slot, with_calibration, *layout, views
        )
        return PathEquations(levels, flat), gradient

    def _linearised_at(
        self, world_from_cam: Floats, with_calibration: bool
    ) -> tuple[_Optimum, Floats, PointViews]:
        at = self._at(world_from_cam)
        self._points = at.points
        poses = np.ascontiguousarray(inverse(world_from_cam)[:, :3])
        views = self.views._replace(huber=_LENS_HUBER) if with_calibration else self.views
        return at, poses, views

    def _at(self, world_from_cam: Floats) -> _Optimum:
        """Optimal points; cached, since optimizers evaluate cost and derivatives separately."""
        if self._latest is None or not np.array_equal(world_from_cam, self._latest.world_from_cam):
            # Points must not be coarser than the poses, whose steps are judged by the cost.
            tolerance = 0.1 * self._config.relative_error_tolerance
            points, cost = best_points(
                self._points,
                inverse(world_from_cam),
                self.views,
                steps=self._config.iterations,
                tolerance=tolerance,
            )
            self._latest = _Optimum(world_from_cam, points, cost)
        return self._latest


class _Optimum(NamedTuple):
    """Optimal points (M, 3) for poses (K, 4, 4), and their cost."""

    world_from_cam: Floats
    points: Floats
    cost: float


def views_of(problem: WindowProblem, point_ok: Bools, config: SmoothingConfig) -> PointViews:
    """The observations of a window's usable points (M,), by point, then keyframe."""
    point, keyframe = problem.point, problem.keyframe
    measured = problem.xy, problem.disparity, problem.sigma_px
    if (keyframe[1:] < keyframe[:-1]).any():  # normal equations need them in order
        order = np.argsort(keyframe, kind="stable")
        point, keyframe = point[order], keyframe[order]
        measured = problem.xy[order], problem.disparity[order], problem.sigma_px[order]
    return point_views(
        point_ok,
        point,
        keyframe,
        PixelObservations(*measured, problem.sigma_disparity_px),
        problem.intrinsics,
        problem.intrinsics[0] * problem.baseline_m,
        config.huber,
    )
