"""Prediction of the next pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vo.base.config import load_config
from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import inverse, orthonormalised, se3_exp
from vo.base.types import Floats, State
from vo.engine.odometry import Odometry
from vo.engine.stages import Components
from vo.engine.tracking.motion_model import ConstantVelocity, MotionModel
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source

TWIST = np.array([0.2, -0.1, 0.3, 1.0, 0.2, -0.5])  # per second


def _pose(time_s: float) -> Floats:
    return np.asarray(se3_exp(np.array([0.5, 0.1, 0, 3, 2, 1])) @ se3_exp(TWIST * time_s))


def _ns(time_s: float) -> int:
    return round(time_s * 1e9)


@pytest.mark.parametrize("step_s", [0.05, 0.1, 0.35, 0.0])
def test_a_constant_twist_is_predicted_whatever_the_time_between_frames(step_s: float) -> None:
    motion = ConstantVelocity()
    motion.restart(_ns(0.0), _pose(0.0))
    motion.update(_ns(0.1), _pose(0.1))
    np.testing.assert_allclose(motion.predict(_ns(0.1 + step_s)), _pose(0.1 + step_s), atol=1e-9)
    np.testing.assert_array_equal(motion.last, _pose(0.1))


def test_after_a_restart_the_camera_is_expected_to_stay() -> None:
    motion = ConstantVelocity()
    np.testing.assert_array_equal(motion.predict(_ns(5.0)), np.eye(4))
    motion.restart(_ns(0.0), _pose(0.0))
    motion.update(_ns(0.1), _pose(0.1))
    motion.restart(_ns(0.2), _pose(1.0))
    np.testing.assert_array_equal(motion.predict(_ns(0.3)), _pose(1.0))


def test_a_correction_moves_the_prediction_along() -> None:
    motion = ConstantVelocity()
    motion.restart(_ns(0.0), _pose(0.0))
    motion.update(_ns(0.1), _pose(0.1))
    moved = se3_exp(np.array([0.0, 0.05, 0.0, 0.1, 0.0, 0.0]))
    motion.move(moved)
    expected = moved @ _pose(0.1) @ se3_exp(TWIST * 0.1)
    np.testing.assert_allclose(motion.predict(_ns(0.2)), expected, atol=1e-9)


def test_rounding_does_not_add_up_over_many_corrections() -> None:
    motion = ConstantVelocity()
    motion.restart(_ns(0.0), _pose(0.0))
    for step in range(1, 200):
        motion.update(_ns(0.1 * step), motion.predict(_ns(0.1 * step)))
        target = se3_exp(np.array([0.3, 0.2, 0.01 * step, 0.1, 0.0, 0.1]))
        motion.move(target @ inverse(motion.last))
    rotation = motion.last[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


def test_two_poses_at_one_time_give_no_velocity() -> None:
    motion = ConstantVelocity()
    motion.restart(_ns(0.1), _pose(0.0))
    motion.update(_ns(0.1), _pose(0.1))
    np.testing.assert_array_equal(motion.predict(_ns(0.2)), _pose(0.1))


class StandsStill(MotionModel):
    """Expects the camera to stay where it is; counts what it is asked for."""

    def __init__(self) -> None:
        self._last: Floats = np.eye(4)
        self.restarts = self.updates = self.moves = self.predictions = 0

    @property
    def last(self) -> Floats:
        return self._last

    def restart(self, stamp_ns: int, world_from_cam: Floats) -> None:
        self._last = world_from_cam
        self.restarts += 1

    def update(self, stamp_ns: int, world_from_cam: Floats) -> None:
        self._last = world_from_cam
        self.updates += 1

    def move(self, motion: Floats) -> None:
        self._last = orthonormalised(motion @ self._last)
        self.moves += 1

    def predict(self, stamp_ns: int) -> Floats:
        self.predictions += 1
        return self._last


@pytest.mark.parametrize("mode", ["stereo", "mono"])
def test_odometry_tracks_with_another_motion_model(synthetic_stereo: Path, mode: str) -> None:
    source = open_source(synthetic_stereo, mode=mode)
    motion = StandsStill()
    odometry = Odometry(source.rig, load_config("fast"), Components(motion=motion))
    estimates = list(odometry.track_all(source.frames()))
    odometry.finish()
    odometry.close()

    states = [estimate.state for estimate in estimates]
    assert State.LOST not in states and states.count(State.TRACKING) >= 25
    truth = read_tum(synthetic_stereo / "groundtruth.tum").positions
    numbers = odometry.trajectory.frames["frame_index"]
    found = odometry.trajectory.trajectory().positions
    fit = umeyama(found, truth[numbers], with_scale=mode == "mono")
    errors_m = np.linalg.norm(fit.transform_points(found) - truth[numbers], axis=1)
    assert np.sqrt(np.mean(errors_m**2)) < 0.01
    assert motion.restarts == 1
    assert motion.updates == states.count(State.TRACKING) - 1
    assert motion.moves > 0 and motion.predictions >= motion.updates
