"""Keyframes with their inertial states."""

from __future__ import annotations

import numpy as np

from vo.base.frozen import frozen
from vo.base.types import Floats
from vo.engine.inertial.estimation import Estimate
from vo.engine.inertial.states import LOG_SCALE

_MAX_SIGMA_LOG_SCALE = 0.03  # of a later segment, from which it is joined
_MAX_SIGMA_DOUBTED = 0.15  # where samples place keyframes, and it is that of frames between


@frozen(eq=False)
class Node:
    """A keyframe."""

    keyframe: int
    frame_index: int
    stamp_ns: int
    segment: int
    world_from_cam: Floats  # (4, 4) in the frame and the units of the segment
    # (6, 6) of the motion from the keyframe before it, as in `Steps`; None to keep that of an
    # earlier call, or for the first one of a segment
    covariance: Floats | None


@frozen(eq=False)
class KeyframeStates:
    """Keyframes with their states."""

    nodes: tuple[Node, ...]
    estimate: Estimate
    world: int  # number of its first segment
    origin: int  # id of its first keyframe; another one is another frame
    doubted: int = 0  # how many of the first ones have images that the samples contradict


def covariances(nodes: list[Node]) -> Floats:
    """(n, 6, 6); 0 where there is none."""
    none = np.zeros((6, 6))
    return np.stack([none if n.covariance is None else n.covariance for n in nodes])


def certain(solved: KeyframeStates) -> list[int]:
    """Rows of the keyframes whose scale is certain enough."""
    sigma = np.sqrt(solved.estimate.covariance[:, LOG_SCALE, LOG_SCALE].clip(0.0))
    is_doubted = np.arange(len(sigma)) < solved.doubted
    limit = np.where(is_doubted, _MAX_SIGMA_DOUBTED, _MAX_SIGMA_LOG_SCALE)
    return np.flatnonzero(sigma < limit).tolist()
