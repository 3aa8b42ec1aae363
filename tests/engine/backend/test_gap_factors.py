"""Motions by an inertial sensor in the window, where frames were lost."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import gtsam
import numpy as np
from inertial_flight import ACCEL_BIAS, GYRO_BIAS, IMU_FROM_CAM, NOISE, START_NS, path, sensor
from inertial_flight import world_from_cam as true_poses

from vo.base.geometry.transforms import se3_exp
from vo.engine.backend.gap_factors import GapFactors, MotionFactor
from vo.engine.inertial.prediction import InertialPredictor, known_motion
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import WIDTH, States
from vo.engine.tracking.inertial_motion import Gap

_STAMPS = START_NS + 1_000_000_000 + np.arange(5) * 500_000_000


def _source(*gaps: tuple[int, int]) -> GapFactors:
    at = int(_STAMPS[0])
    rotation, position, velocity, _, _ = path(np.array([1e-9 * (at - START_NS)]))
    states = States(rotation, position, velocity, GYRO_BIAS[None], ACCEL_BIAS[None], np.zeros(1))
    known = known_motion(at, states, np.diag(np.full(WIDTH, 1e-6)))
    predictor = InertialPredictor(SampleReader(sensor()), NOISE, IMU_FROM_CAM)
    motion = SimpleNamespace(gaps=[Gap(first, last, known) for first, last in gaps])
    return GapFactors(motion, predictor)


def _keyframes() -> Any:
    return [
        SimpleNamespace(id=k, frame=SimpleNamespace(stamp_ns=int(stamp)))
        for k, stamp in enumerate(_STAMPS)
    ]


def test_without_a_gap_the_window_is_that_without_a_sensor() -> None:
    assert _source().factors(_keyframes()) == []


def test_a_gap_joins_the_keyframes_beside_it_by_their_true_motion() -> None:
    gap = int(_STAMPS[1]) + 100_000_000, int(_STAMPS[2])
    (factor,) = _source(gap).factors(_keyframes())
    assert isinstance(factor, MotionFactor) and (factor.first, factor.second) == (1, 2)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    true = true_poses(_STAMPS)
    for k, pose in enumerate(true):
        values.insert(k, gtsam.Pose3(pose))
    factor.add_to(graph, values, int)
    assert graph.error(values) < 0.1
    values.update(2, gtsam.Pose3(true[2] @ se3_exp(np.array([0.0, 0, 0, 0.1, 0, 0]))))
    assert graph.error(values) > 100.0
