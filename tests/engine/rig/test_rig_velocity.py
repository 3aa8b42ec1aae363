"""The velocity of a rig whose cameras take their images one after the other."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from vo.base.geometry.transforms import inverse, se3_exp, se3_log
from vo.base.types import Floats
from vo.engine.rig.velocity import BodyVelocity
from vo.engine.rig.window import RigWindow

VELOCITY = np.array([0.1, 0.6, -0.1, 1.5, 0.2, -0.3])
ACCELERATION = np.array([0.0, 0.5, 0.0, 3.0, 0.0, -2.0])
DELAY_S = (0.0, 0.02, 0.04)


def pose(time_s: float) -> Floats:
    """world_from_body of a body that is accelerated."""
    return se3_exp(time_s * VELOCITY + 0.5 * time_s**2 * ACCELERATION)


def test_the_next_frame_shows_where_the_late_views_of_the_one_before_were() -> None:
    velocity = BodyVelocity()
    assert velocity.update(pose(-0.1), pose(0.0), 0.1, DELAY_S) is None
    moved = velocity.update(pose(0.0), pose(0.1), 0.1, DELAY_S)
    assert moved is not None
    constant = [se3_exp(d * se3_log(inverse(pose(-0.1)) @ pose(0.0)) / 0.1) for d in DELAY_S]
    for found, before, delay_s in zip(moved, constant, DELAY_S, strict=True):
        assert np.abs(se3_log(inverse(pose(delay_s)) @ found)).max() < 2e-4
        if delay_s:  # from the velocity since the frame before alone
            assert np.abs(se3_log(inverse(pose(delay_s)) @ before)).max() > 0.003


def test_the_prior_is_as_wide_as_velocities_change() -> None:
    still, shaken = BodyVelocity(), BodyVelocity()
    random = np.random.default_rng(0)
    before = last = np.eye(4)
    for number in range(60):
        still.update(pose(0.1 * number), pose(0.1 * number) @ se3_exp(0.1 * VELOCITY), 0.1, (0.0,))
        last = before @ se3_exp(0.1 * (VELOCITY + random.normal(0, 1.0, 6)))
        shaken.update(before, last, 0.1, (0.0,))
        before = last
    assert still.prior(np.eye(4), 0.1).sigma.max() < 0.03
    assert 0.8 < shaken.prior(last, 0.1).sigma.min() < 2.0  # 1.4 of a difference
    ahead = still.prior(np.eye(4), 0.1).velocity(se3_exp(0.1 * VELOCITY))
    np.testing.assert_allclose(ahead, VELOCITY, atol=1e-9)


@dataclass(eq=False)
class _Keyframe:
    id: int
    world_from_cam: Floats
    frame: Any


def test_only_the_views_of_that_frame_are_placed_anew() -> None:
    window = RigWindow.__new__(RigWindow)
    frames = [SimpleNamespace(index=7), SimpleNamespace(index=8)]
    keyframes = [_Keyframe(n, pose(0.1 * n), frames[n // 2]) for n in range(4)]
    window._views, window._retied = 2, None
    window._map = cast(Any, SimpleNamespace(keyframes=keyframes))
    tied = np.stack([np.eye(4), pose(0.5)])
    of_frame = [
        cast(Any, SimpleNamespace(frame=f, tracked=SimpleNamespace(body_from_views=tied)))
        for f in frames
    ]
    window.retie(of_frame[0])  # not the newest keyframe
    window.retie(None)
    np.testing.assert_allclose(keyframes[3].world_from_cam, pose(0.3), atol=1e-12)
    window.retie(of_frame[1])
    np.testing.assert_allclose(keyframes[3].world_from_cam, pose(0.2) @ pose(0.5), atol=1e-12)
    np.testing.assert_allclose(keyframes[1].world_from_cam, pose(0.1), atol=1e-12)
