"""The scale of cameras that see nothing in common, from the turns of the rig."""

from __future__ import annotations

from contextlib import closing

from rig_walks import Walk, ate, scale_of

from vo.base.config import load_config
from vo.engine.odometry import Odometry
from vo.engine.rig.creation import make_odometry
from vo.engine.rig.odometry import RigOdometry


def test_turns_give_the_scale_and_its_sigma(apart: Walk) -> None:
    with closing(make_odometry(apart.rig, load_config(overrides=["threads=1"]))) as odometry:
        assert isinstance(odometry, RigOdometry)
        estimates = [odometry.track(frame) for frame in apart.frames]
        odometry.finish()
        (scale,) = odometry.measure(odometry.trajectory.path()).scales
        path = odometry.trajectory.trajectory()
        assert not odometry.trajectory.metric.is_metric(0)
        odometry.trajectory.apply_scales({0: scale})
        assert odometry.trajectory.metric.is_metric(0)
        in_metres = odometry.trajectory.trajectory()
    assert len(path) > 0.9 * len(apart.frames)
    assert {estimate.segment for estimate in estimates} == {0}
    assert ate(path, apart.truth, with_scale=True) < 0.004
    error = scale_of(in_metres, apart.truth) - 1.0
    assert abs(error) < 0.02
    assert abs(error) < 3.0 * scale.relative_sigma < 0.06
    assert ate(in_metres, apart.truth) < 0.01


def test_without_turns_there_is_no_scale(apart: Walk) -> None:
    with closing(make_odometry(apart.rig, load_config(overrides=["threads=1"]))) as odometry:
        assert isinstance(odometry, RigOdometry)
        for frame in apart.frames[:9]:
            odometry.track(frame)
        odometry.finish()
        scales = odometry.measure(odometry.trajectory.path()).scales
        assert all(scale.relative_sigma > 0.02 for scale in scales)


def test_cameras_that_see_the_same_remain_a_pair(walk: Walk) -> None:
    with closing(make_odometry(walk.rig.first(2), load_config(overrides=["threads=1"]))) as pair:
        assert isinstance(pair, Odometry)
