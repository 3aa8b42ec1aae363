"""Paths of the moving bodies of a world."""

from __future__ import annotations

import numpy as np

from data_synth.motion.route import Route, make_route
from data_synth.scene.scene import Body, Heights
from vo.base.types import Floats

_SLOPE_STEP_M = 0.05


def poses_at(body: Body, times_s: Floats, ground: Heights) -> tuple[Floats, Floats]:
    """Poses of a body that moves along its route at constant speed, upright, facing ahead.

    It cuts corners by at most its radius. A route of two points becomes a narrow loop there and
    back.

    `times_s`: (N,).

    Returns world_from_body (N, 4, 4), its origin on the ground, and velocities (N, 3) in the world.
    """
    route = _route(body, ground)
    along = body.start * route.length_m + body.speed_m_s * np.asarray(times_s, dtype=np.float64)
    ahead = route.at(along, 1)
    ahead = ahead[:, :2] / np.linalg.norm(ahead[:, :2], axis=1, keepdims=True)
    xy = route.at(along)[:, :2]
    poses = np.zeros((len(xy), 4, 4))
    poses[:, :2, 0] = ahead
    poses[:, :2, 1] = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    poses[:, 2, 2] = poses[:, 3, 3] = 1.0
    poses[:, :2, 3] = xy
    poses[:, 2, 3] = ground(xy)
    step = _SLOPE_STEP_M * ahead
    slope = (ground(xy + step) - ground(xy - step)) / (2.0 * _SLOPE_STEP_M)
    return poses, body.speed_m_s * np.column_stack([ahead, slope])


def _route(body: Body, ground: Heights) -> Route:
    corners = np.asarray(body.route, dtype=np.float64)
    if len(corners) == 2:
        ahead = corners[1] - corners[0]
        left = np.array([-ahead[1], ahead[0]]) * body.radius_m / np.linalg.norm(ahead)
        corners = np.array(
            [corners[0] - left, corners[1] - left, corners[1] + left, corners[0] + left]
        )
    return make_route(
        corners,
        ground,
        cut_m=body.radius_m,
        weave_m=0.0,
        weave_length_m=10.0,
        level_m=0.0,
        rng=np.random.default_rng(0),
    )
