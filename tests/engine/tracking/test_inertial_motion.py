"""Prediction through lost frames, and when a map is given up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from inertial_flight import ACCEL_BIAS, GYRO_BIAS, IMU_FROM_CAM, NOISE, START_NS, path, sensor
from inertial_flight import world_from_cam as true_poses

from vo.base.geometry.transforms import inverse, se3_exp, se3_log
from vo.base.types import Floats
from vo.engine.inertial.prediction import InertialPredictor, known_motion
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import WIDTH, States
from vo.engine.recovery import LossPolicy
from vo.engine.tracking.inertial_motion import InertialMotion
from vo.engine.tracking.motion_model import ConstantVelocity, PosePrior

_STAMPS = START_NS + 1_000_000_000 + np.arange(60) * 50_000_000
_TRUE = true_poses(_STAMPS)
_TRACKED = 30


def _predictor() -> InertialPredictor:
    return InertialPredictor(SampleReader(sensor()), NOISE, IMU_FROM_CAM)


def _tracked(predictor: InertialPredictor, *, is_metric: bool = True) -> InertialMotion:
    """The first frames tracked, and the motion known at the last but two of them."""
    motion = InertialMotion(ConstantVelocity(), predictor, is_metric=is_metric)
    motion.restart(int(_STAMPS[0]), _TRUE[0])
    for k in range(1, _TRACKED):
        motion.predict(int(_STAMPS[k]))
        motion.update(int(_STAMPS[k]), _TRUE[k])
    at = int(_STAMPS[_TRACKED - 3])
    rotation, position, velocity, _, _ = path(np.array([1e-9 * (at - START_NS)]))
    states = States(rotation, position, velocity, GYRO_BIAS[None], ACCEL_BIAS[None], np.zeros(1))
    predictor.known = known_motion(at, states, np.diag(np.full(WIDTH, 1e-6)))
    predictor.gyro_bias = GYRO_BIAS
    return motion


def _usual() -> ConstantVelocity:
    usual = ConstantVelocity()
    usual.restart(int(_STAMPS[0]), _TRUE[0])
    for k in range(1, _TRACKED):
        usual.update(int(_STAMPS[k]), _TRUE[k])
    return usual


def _lost(motion: InertialMotion, count: int) -> Floats:
    """Predict so many frames after the last one; the pose of the last of them."""
    for k in range(count):
        pose = motion.predict(int(_STAMPS[_TRACKED + k]))
    return pose


def test_the_frame_after_a_tracked_one_is_predicted_as_without_a_sensor() -> None:
    motion, stamp = _tracked(_predictor()), int(_STAMPS[_TRACKED])
    assert (motion.predict(stamp) == _usual().predict(stamp)).all()
    assert motion.prior(stamp) is None


def test_in_a_quick_turn_and_after_it_the_sensor_leads_a_single_camera(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stamps = [int(stamp) for stamp in _STAMPS[_TRACKED : _TRACKED + 8]]
    slow = _tracked(_predictor(), is_metric=False)
    assert slow.prior(stamps[0]) is None
    monkeypatch.setattr("vo.engine.tracking.inertial_motion.QUICK_RAD_S", 0.05)
    two, one = (_tracked(_predictor(), is_metric=each) for each in (True, False))
    assert two.prior(stamps[0]) is None
    prior = one.prior(stamps[0])
    assert prior is not None and prior.leads
    assert np.abs(se3_log(inverse(prior.world_from_cam) @ _TRUE[_TRACKED])).max() < 1e-3
    one.update(stamps[0], _TRUE[_TRACKED])
    (gap,) = one.gaps
    assert gap.last_ns == stamps[0]  # a factor of the window
    monkeypatch.setattr("vo.engine.tracking.inertial_motion.QUICK_RAD_S", 5.0)
    leading = []
    for k, stamp in enumerate(stamps[1:], start=_TRACKED + 1):
        leading.append(one.prior(stamp) is not None)
        one.update(stamp, _TRUE[k])
    assert leading == [True] * 6 + [False]


def test_a_second_of_lost_frames_is_predicted() -> None:
    motion = _tracked(_predictor())
    found = _lost(motion, 21)
    error = se3_log(inverse(found) @ _TRUE[_TRACKED + 20])
    assert np.abs(error).max() < 3e-3
    usual = _usual().predict(int(_STAMPS[_TRACKED + 20]))
    assert np.abs(se3_log(inverse(usual) @ _TRUE[_TRACKED + 20])).max() > 0.1


def test_every_lost_frame_of_a_map_is_predicted() -> None:
    motion = _tracked(_predictor())
    for k in range(3):
        stamp = int(_STAMPS[_TRACKED + k])
        motion.predict(stamp)
        lost = motion.of_lost(stamp)
        assert lost is not None  # the first one, which has no prior, too
        assert np.abs(se3_log(inverse(lost.world_from_cam) @ _TRUE[_TRACKED + k])).max() < 3e-3
        np.testing.assert_allclose(lost.covariance @ lost.information, np.eye(6), atol=1e-8)
    motion.give_up()
    assert motion.of_lost(int(_STAMPS[_TRACKED + 3])) is None


def test_no_lost_frame_is_predicted_while_the_states_are_unknown() -> None:
    predictor = _predictor()
    motion = _tracked(predictor)
    predictor.known = None
    motion.predict(int(_STAMPS[_TRACKED]))
    assert motion.of_lost(int(_STAMPS[_TRACKED])) is None


def test_a_gap_is_remembered_until_the_next_map() -> None:
    motion = _tracked(_predictor())
    _lost(motion, 11)
    after = _TRACKED + 10
    motion.update(int(_STAMPS[after]), _TRUE[after])
    (gap,) = motion.gaps
    assert (gap.first_ns, gap.last_ns) == (_STAMPS[_TRACKED - 1], _STAMPS[after])
    motion.restart(int(_STAMPS[after + 1]), np.eye(4))
    assert motion.gaps == []


def test_nothing_is_predicted_by_the_sensor_after_giving_up() -> None:
    motion = _tracked(_predictor())
    motion.give_up()
    _lost(motion, 11)
    assert motion.prior(int(_STAMPS[_TRACKED + 10])) is None


def test_a_measured_pose_is_weighted_with_the_predicted_one() -> None:
    true = _TRUE[5]
    prior = PosePrior(true @ se3_exp(np.array([0.0, 0.0, 0.0, 0.02, 0.0, 0.0])), 1e4 * np.eye(6))
    measured = inverse(true @ se3_exp(np.array([0.0, 0.0, 0.0, -0.01, 0.0, 0.0])))
    off = se3_log(inverse(true) @ inverse(prior.fused(measured, 2e4 * np.eye(6))))
    np.testing.assert_allclose(off, 0.0, atol=1e-9)
    strong = prior.fused(measured, 1e12 * np.eye(6))
    np.testing.assert_allclose(strong, measured, atol=1e-6)


@pytest.mark.parametrize(("error_m", "is_contradicted"), [(0.05, False), (0.3, True)])
def test_a_pose_far_from_the_predicted_one_is_refused(
    error_m: float, is_contradicted: bool
) -> None:
    prior = PosePrior(_TRUE[5], 1e4 * np.eye(6))  # 1 cm
    measured = inverse(_TRUE[5] @ se3_exp(np.array([0.0, 0.0, 0.0, error_m, 0.0, 0.0])))
    assert prior.is_contradicted(measured, 1e6 * np.eye(6)) is is_contradicted


def _frames(count: int) -> Any:
    return [SimpleNamespace(stamp_ns=int(s)) for s in _STAMPS[:count]]


def test_a_map_is_kept_longer_while_the_motion_is_known() -> None:
    predictor = _predictor()
    policy = LossPolicy(10, predictor)
    assert not policy.gives_up(_frames(10)) and policy.gives_up(_frames(11))
    _tracked(predictor)
    assert not policy.gives_up(_frames(11)) and not policy.gives_up(_frames(30))
    assert policy.gives_up(_frames(31))  # 1.5 s
    assert LossPolicy(10, None).gives_up(_frames(11))
