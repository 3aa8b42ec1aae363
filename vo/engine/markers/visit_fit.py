"""Where a marker is in the frame of a keyframe, from the keyframes of one visit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Floats
from vo.engine.geometry import sim3
from vo.engine.markers.marker_problem import MarkerProblem, MarkerView

# Of the length of a marker in a metric path: its print and the calibration.
_UNIT_SIGMA = 0.01
# What the noise of corners and the drift of the path do not contain, such as a lens that is not
# quite that of the calibration: radians, and ratio of the distance of the marker.
_MIN_RAD, _MIN_RATIO = 0.003, 0.003
# Beyond these a pose is too uncertain: its scale, its position relative to its distance, radians.
_MAX_UNIT_SIGMA, _MAX_POSITION_SIGMA, _MAX_RAD = 0.1, 0.1, 0.1


class VisitPose(NamedTuple):
    """A marker relative to a camera.

    Attributes:
        cam_from_marker: (4, 4) similarity from metres in the frame of the marker to the frame and
            unit of the camera's path; rigid if that is metric.
        covariance: (7, 7) of its tangent in the frame of the marker, in metres.
    """

    cam_from_marker: Floats
    covariance: Floats


def fit_visit(
    views: Sequence[MarkerView], world_from_cam0: Floats, *, is_metric: bool
) -> VisitPose | None:
    """The pose of a marker in the first of several cameras that see it, in time order.

    None where it, or in a path of one camera its scale, is too uncertain. No view is ambiguous;
    `world_from_cam0` (N, 4, 4) is in the unit of the path.
    """
    sigma = _UNIT_SIGMA if is_metric else None
    problem = MarkerProblem(views, world_from_cam0, [views[0].id], sigma)
    start = problem.first_guess(fixed_scale=is_metric)
    solution = None if start is None else problem.solve(start)
    if solution is None:
        return None
    state = solution[0]
    units = 1.0 if is_metric else state.units
    covariance = _in_marker(state.rotations[0], units, problem.covariance(solution))
    if is_metric:
        covariance[6] = covariance[:, 6] = 0.0
    world_from_marker = make_transform(state.rotations[0], state.positions[0])
    cam_from_marker = inverse(world_from_cam0[0]) @ sim3.similarity(world_from_marker, units)
    distance_m = float(np.linalg.norm(cam_from_marker[:3, 3])) / units
    turned, moved = (np.linalg.eigvalsh(covariance[k : k + 3, k : k + 3])[-1] for k in (0, 3))
    if not (
        turned < _MAX_RAD**2
        and moved < (_MAX_POSITION_SIGMA * distance_m) ** 2
        and covariance[6, 6] < _MAX_UNIT_SIGMA**2
    ):
        return None
    unmodelled = np.r_[np.full(3, _MIN_RAD), np.full(3, _MIN_RATIO * distance_m), 0.0]
    return VisitPose(cam_from_marker, covariance + np.diag(unmodelled**2))


def _in_marker(rotation: Floats, units: float, covariance: Floats) -> Floats:
    """(7, 7) of exp(w) R, position + d and units exp(l) as a tangent in the marker's frame."""
    back = np.zeros((7, 7))
    back[:3, :3] = rotation.T
    back[3:6, 3:6] = rotation.T / units
    back[6, 6] = 1.0
    return np.asarray(back @ covariance @ back.T)
