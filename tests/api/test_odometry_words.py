"""`vo.Odometry` with inertial samples, loops and maps, and poses at any time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vo
from vo.recordings.sources.imu import ImuSamples
from vo.recordings.sources.source import Recording

FRAMES = 90


def opened(source: Path, mode: str) -> Recording:
    recording = vo.open(source, mode=mode)  # type: ignore[arg-type]
    assert isinstance(recording, Recording)
    return recording


def tracked_with_samples(
    recording: Recording, samples: ImuSamples, *, late_ns: int = -6_000_000, predicts: bool = True
) -> tuple[vo.Odometry, list[vo.Estimate], list[vo.PredictedPose | None]]:
    """Samples up to 6 ms after each frame come before it, or later."""
    given, estimates, poses = 0, [], []
    with vo.Odometry(recording.rig, imu=recording.imus[0], loops=True) as odometry:
        for frame in recording.frames(end=FRAMES):
            until = int(np.searchsorted(samples.stamps_ns, frame.stamp_ns - late_ns))
            for row in range(given, until):
                odometry.add_imu(int(samples.stamps_ns[row]), samples.gyro[row], samples.accel[row])
            given = max(given, until)
            poses.append(odometry.predict(frame.stamp_ns) if predicts else None)
            estimates.append(odometry.track(frame.stamp_ns, *frame.images))
    return odometry, estimates, poses


@pytest.mark.parametrize("mode", ["stereo", "mono"])
def test_samples_beside_frames_give_the_bytes_of_the_command(
    mode: str, shared_data: Path, tmp_path: Path
) -> None:
    recording = opened(shared_data / "rendered_hall_stereo", mode)
    samples = recording.imus[0].read()
    words: Any = {"mode": mode, "end": FRAMES}
    vo.run(shared_data / "rendered_hall_stereo", tmp_path / "run", **words)
    odometry, estimates, poses = tracked_with_samples(recording, samples)
    vo.write_trajectory(tmp_path / "path.tum", odometry.trajectory())
    ours = (tmp_path / "path.tum").read_bytes()
    assert ours == (tmp_path / "run" / "trajectory.tum").read_bytes()
    use = odometry.summary().inertial
    assert use is not None and use.states is not None and not odometry.summary().warnings

    errors, sigmas = [], []
    for estimate, predicted in list(zip(estimates, poses, strict=True))[70:]:
        assert predicted is not None and predicted.covariance is not None
        assert estimate.world_from_cam0 is not None
        off = np.linalg.inv(predicted.world_from_cam0) @ estimate.world_from_cam0
        errors.append(np.linalg.norm(off[:3, 3]))
        sigmas.append(np.sqrt(np.trace(predicted.covariance[3:, 3:])))
    assert np.median(errors) < 0.003 and max(errors) < 0.012  # of steps of 50 mm
    assert (np.array(errors) < 4 * np.array(sigmas)).all()
    assert odometry.predict(estimates[-1].stamp_ns + 10) is None  # it is closed
    path = odometry.trajectory()
    middle = odometry.predict(int(path.stamps_ns[40:42].mean()))
    assert middle is not None
    off = middle.world_from_cam0[:3, 3] - path.positions[40:42].mean(axis=0)
    assert np.linalg.norm(off) < 0.001


def test_samples_that_come_late_are_said(shared_data: Path) -> None:
    recording = opened(shared_data / "rendered_hall_stereo", "stereo")
    samples = recording.imus[0].read()
    odometry, estimates, _ = tracked_with_samples(
        recording, samples, late_ns=400_000_000, predicts=False
    )
    assert all(each.state.has_pose for each in estimates)
    (warning,) = odometry.summary().warnings
    assert "inertial samples came after a frame that is newer" in warning


def test_without_a_sensor_poses_ahead_keep_the_velocity(synthetic_stereo: Path) -> None:
    recording = opened(synthetic_stereo, "stereo")
    frames = list(recording.frames())
    with vo.Odometry(recording.rig) as odometry:
        assert odometry.predict(frames[0].stamp_ns) is None
        for frame in frames[:-1]:
            estimate = odometry.track(frame.stamp_ns, *frame.images)
        assert odometry.predict(frames[0].stamp_ns - 1) is None
        ahead = odometry.predict(frames[-1].stamp_ns)
        assert odometry.predict(estimate.stamp_ns + 1_000_000_001) is None
        now = odometry.track(frames[-1].stamp_ns, *frames[-1].images)
        with pytest.raises(vo.InputError, match="a float"):
            odometry.predict(1e9)  # type: ignore[arg-type]
        with pytest.raises(vo.VoError, match="create the odometry with imu=True"):
            odometry.add_imu(1, (0, 0, 0), (0, 0, 9.81))
    assert ahead is not None and ahead.covariance is None
    assert now.position is not None and estimate.position is not None
    step = np.linalg.norm(now.position - estimate.position)
    assert np.linalg.norm(ahead.world_from_cam0[:3, 3] - now.position) < 0.2 * step


def test_a_sample_that_cannot_be_meant_is_left_out(synthetic_stereo: Path) -> None:
    recording = opened(synthetic_stereo, "stereo")
    with pytest.raises(vo.CalibrationError, match="the pose of the inertial sensor"):
        vo.Odometry(recording.rig, imu=True)
    with pytest.raises(vo.ConfigError, match="the option imu is 'on'"):
        vo.Odometry(recording.rig, imu="on")  # type: ignore[arg-type]
    bad: list[tuple[tuple[Any, Any, Any], str]] = [
        ((1.5, (0, 0, 0), (0, 0, 9)), "a float"),
        ((5, (0, 0), (0, 0, 9)), r"gyro has shape \(2,\)"),
        ((5, (0, 0, 0), (0, np.nan, 9)), "accel is .* not finite"),
        ((5, "abc", (0, 0, 9)), "gyro is of type str"),
    ]
    with vo.Odometry(recording.rig, imu=vo.ImuCalibration(np.eye(4))) as odometry:
        for sample, message in bad:
            with pytest.raises(vo.InputError, match=message):
                odometry.add_imu(*sample)
        odometry.add_imu(7, (0, 0, 0), (0, 0, 9.81))
        with pytest.raises(vo.InputError, match="stamp_ns is 7, the sample before had 7"):
            odometry.add_imu(7, (0, 0, 0), (0, 0, 9.81))


def test_samples_in_other_units_are_not_used(synthetic_stereo: Path) -> None:
    recording = opened(synthetic_stereo, "stereo")
    noise = np.random.default_rng(1).normal(0, 0.01, (2000, 6))
    with vo.Odometry(recording.rig, imu=vo.ImuCalibration(np.eye(4))) as odometry:
        with pytest.raises(vo.InputError, match="probably in g instead of m/s²"):
            for row, each in enumerate(noise):
                odometry.add_imu(row * 5_000_000, each[:3], each[3:] + [0, 0, 1])
        assert row == 800  # after 4 s
        frame = next(iter(recording.frames()))
        assert odometry.track(frame.stamp_ns, *frame.images).state.has_pose
    use = odometry.summary().inertial
    assert use is not None and use.is_error and "in g" in str(use.reason)


def test_loops_maps_and_localisation_are_those_of_the_command(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    recording = opened(synthetic_stereo, "stereo")
    saved, house = tmp_path / "ours.map", tmp_path / "house.map"
    vo.run(synthetic_stereo, tmp_path / "first", save_map=house, imu=False)
    vo.run(synthetic_stereo, tmp_path / "second", map=house, localize=True, imu=False)

    def path_of(name: str, **words: Any) -> bytes:
        with vo.Odometry(recording.rig, **words) as odometry:
            for frame in recording.frames():
                odometry.track(frame.stamp_ns, *frame.images)
        vo.write_trajectory(tmp_path / name, odometry.trajectory())
        return (tmp_path / name).read_bytes()

    assert path_of("a.tum", save_map=saved) == (tmp_path / "first/trajectory.tum").read_bytes()
    assert vo.maps.info(saved)["worlds"] == vo.maps.info(house)["worlds"]
    ours = path_of("b.tum", map=str(house), localize=True)
    assert ours == (tmp_path / "second/trajectory.tum").read_bytes()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"mapp": "a.map"}, "unknown option 'mapp'; did you mean 'map'?"),
        ({"localize": True}, "finds poses in a map"),
        ({"save_map": "a.map", "loops": False}, "`save_map` needs loops"),
        ({"loops": True, "config": vo.Config()}, "memory.loops is a setting"),
    ],
)
def test_words_that_cannot_be_meant_are_refused(
    words: dict[str, Any], message: str, synthetic_stereo: Path
) -> None:
    with pytest.raises(vo.ConfigError) as error:
        vo.Odometry(opened(synthetic_stereo, "stereo").rig, **words)
    assert message in str(error.value)
