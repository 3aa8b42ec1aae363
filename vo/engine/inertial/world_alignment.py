"""Alignment of worlds: upright, in metres, or at the first camera."""

from __future__ import annotations

import math

import numpy as np

from vo.base.geometry.similarity import Similarity
from vo.base.geometry.transforms import adjoint, inverse, so3_exp
from vo.base.types import Floats
from vo.engine.inertial.initialisation import upright
from vo.engine.inertial.states import GRAVITY, States

_UP = np.array([0.0, 0.0, 1.0])


def upright_alignment(
    graph: Floats, graph_scale: Floats, inertial: Floats, inertial_scale: Floats
) -> Similarity:
    """The similarity that gives the world of a pose graph the metre and the vertical.

    The scale and the direction of gravity are the mean over all keyframes, as the graph has removed
    the drift of both. Heading and position are those of the first keyframe.

    Args:
        graph: (n, 4, 4) poses of keyframes as the graph has placed them.
        graph_scale: (n,) length in its world of one unit of their own segments.
        inertial: (n, 4, 4) the same in a world whose z axis points up, in metres.
        inertial_scale: (n,) metres of one unit of their own segments.
    """
    scale = math.exp(float(np.log(inertial_scale / graph_scale).mean()))
    up = (graph[:, :3, :3] @ inertial[:, 2, :3, None])[:, :, 0].mean(axis=0)
    axis = np.cross(up, _UP)
    sine = float(np.linalg.norm(axis))
    angle = math.atan2(sine, float(up @ _UP))
    turn = so3_exp(axis * (angle / max(sine, 1e-12)))
    between = inertial[0, :3, :3] @ (turn @ graph[0, :3, :3]).T
    heading = math.atan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1])
    rotation = so3_exp(heading * _UP) @ turn
    translation = inertial[0, :3, 3] - scale * rotation @ graph[0, :3, 3]
    return Similarity(scale, rotation, translation)


def alignment_covariance(world_from_cam: Floats, sigma_scale: float, sigma_tilt: float) -> Floats:
    """What errors of the scale and the vertical add to covariances (n, 6, 6) of poses.

    `sigma_scale` is relative, `sigma_tilt` about each horizontal axis in radians.
    """
    cam_from_world = inverse(world_from_cam)
    tilt = adjoint(cam_from_world)[:, :, :2]
    result = sigma_tilt**2 * tilt @ np.swapaxes(tilt, 1, 2)
    along = cam_from_world[:, :3, 3]  # to the origin
    result[:, 3:, 3:] += sigma_scale**2 * along[:, :, None] * along[:, None, :]
    return np.asarray(result)


def placed_at_origin(states: States, imu_from_cam: Floats) -> States:
    """The same states, turned about the vertical and moved: the first camera is the origin."""
    camera = states.position[0] + states.rotation[0] @ imu_from_cam[:3, 3]
    turn = upright(states.rotation[0] @ imu_from_cam[:3, :3], GRAVITY)
    return states._replace(
        rotation=turn @ states.rotation,
        position=(states.position - camera) @ turn.T,
        velocity=states.velocity @ turn.T,
    )
