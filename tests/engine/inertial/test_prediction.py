"""Motion by inertial samples after a state that is known."""

from __future__ import annotations

import numpy as np
from inertial_flight import (
    ACCEL_BIAS,
    GYRO_BIAS,
    IMU_FROM_CAM,
    NOISE,
    START_NS,
    path,
    sensor,
    world_from_cam,
)

from vo.base.geometry.transforms import inverse, se3_log
from vo.base.types import Floats
from vo.engine.inertial.prediction import (
    InertialPredictor,
    KnownMotion,
    RelativeMotion,
    known_motion,
    without_inertial,
)
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import WIDTH, States

_KNOWN, _FIRST, _LAST = (START_NS + t * 100_000_000 for t in (20, 24, 36))
_SCALE = 0.5
# Of rotation, position, velocity, biases of both, logarithm of the scale.
_SIGMA = np.r_[[2e-3] * 3, [0.0] * 3, [0.03] * 3, [5e-4] * 3, [0.02] * 3, 0.01]


def _states() -> States:
    rotation, position, velocity, _, _ = path(np.array([1e-9 * (_KNOWN - START_NS)]))
    return States(rotation, position, velocity, GYRO_BIAS[None], ACCEL_BIAS[None], np.log([_SCALE]))


def _known(error: Floats | None = None) -> KnownMotion:
    states = _states() if error is None else _states().moved(error[None])
    return known_motion(_KNOWN, states, np.diag(_SIGMA**2))


def _predictor(noise: float = 0.0) -> InertialPredictor:
    return InertialPredictor(SampleReader(sensor(noise=noise)), NOISE, IMU_FROM_CAM)


def _true() -> Floats:
    first, last = world_from_cam(np.array([_FIRST, _LAST]))
    motion = inverse(first) @ last
    motion[:3, 3] /= _SCALE
    return np.asarray(motion)


def _motion(predictor: InertialPredictor, known: KnownMotion) -> RelativeMotion:
    found = predictor.motion(known, _FIRST, _LAST)
    assert found is not None
    return found


def test_exact_states_predict_the_exact_motion_in_units_of_the_map() -> None:
    found = _motion(_predictor(), _known())
    np.testing.assert_allclose(found.first_from_last, _true(), atol=1e-3)


def test_errors_are_those_that_are_stated() -> None:
    rng, predictor = np.random.default_rng(5), _predictor(noise=1.0)
    squared = []
    for _ in range(60):
        found = _motion(predictor, _known(_SIGMA * rng.standard_normal(WIDTH)))
        off = se3_log(inverse(found.first_from_last) @ _true())
        squared.append(off @ np.linalg.solve(found.covariance, off))
    assert 4.0 < np.mean(squared) < 8.0  # 6 degrees of freedom


def test_nothing_is_predicted_from_the_future_or_for_long() -> None:
    predictor, known = _predictor(), _known()
    assert predictor.motion(None, _FIRST, _LAST) is None
    assert predictor.motion(known, _KNOWN - 1, _LAST) is None
    assert predictor.motion(known, _FIRST, _FIRST + 3_100_000_000) is None
    assert predictor.motion(known, _FIRST, START_NS + 20_000_000_000) is None  # no samples


def _covariances() -> tuple[Floats, Floats]:
    """Covariances of a motion by images, and of an inertial one."""
    inertial = _predictor().motion(_known(), _FIRST, _LAST)
    assert inertial is not None
    scale = np.repeat([0.001, 0.02], 3)[:, None]
    root = np.random.default_rng(5).normal(size=(6, 6)) * scale
    return root @ root.T, inertial.covariance


def test_inertial_information_is_taken_out_of_a_motion_again() -> None:
    visual, inertial = _covariances()
    both = np.linalg.inv(np.linalg.inv(visual) + np.linalg.inv(inertial))
    assert np.linalg.det(both) < 0.5 * np.linalg.det(visual)
    units = np.sqrt(np.outer(np.diag(visual), np.diag(visual)))
    np.testing.assert_allclose(without_inertial(both, inertial) / units, visual / units, atol=1e-6)


def test_a_motion_that_is_inertial_alone_keeps_a_hundredth_of_its_information() -> None:
    inertial = _covariances()[1]
    np.testing.assert_allclose(without_inertial(inertial, inertial), 100.0 * inertial, rtol=1e-6)
    np.testing.assert_allclose(
        without_inertial(2.0 * inertial, inertial), 200.0 * inertial, rtol=1e-6
    )


def test_rotations_by_the_gyroscope_need_its_bias() -> None:
    predictor = _predictor()
    assert predictor.turned(_FIRST, _LAST) is None
    predictor.gyro_bias = GYRO_BIAS
    turned = predictor.turned(_FIRST, _LAST)
    assert turned is not None
    first, last = world_from_cam(np.array([_FIRST, _LAST]))
    np.testing.assert_allclose(turned, first[:3, :3].T @ last[:3, :3], atol=1e-4)
    assert predictor.turned(_LAST, _LAST + 10**12) is None
