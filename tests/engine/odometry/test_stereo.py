"""A stereo walk, end to end."""

from __future__ import annotations

import numpy as np
import pytest
from recorded_walk import CONFIG, COUNT, Recording, Run, aligned, track

from vo.base.config import load_config
from vo.base.faults import FaultKind
from vo.base.geometry.transforms import inverse, rotation_angle, se3_log
from vo.base.types import State
from vo.engine.odometry import Odometry


def test_stereo_tracks_every_frame_in_one_segment(stereo: Run) -> None:
    assert set(stereo.states) == {State.TRACKING}
    assert stereo.numbers == list(range(COUNT))
    assert {e.segment for e in stereo.estimates} == {0}
    assert all(e.failure is None for e in stereo.estimates)


def test_stereo_errs_by_less_than_a_hundredth_of_the_path(
    stereo: Run, recording: Recording
) -> None:
    ate, _ = aligned(stereo, recording, with_scale=False)
    assert ate < 0.01 * recording.path_m


def test_stereo_scale_is_true_to_one_percent(stereo: Run, recording: Recording) -> None:
    _, fit = aligned(stereo, recording, with_scale=True)
    assert fit.scale == pytest.approx(1.0, abs=0.01)


def test_stereo_turns_are_true(stereo: Run, recording: Recording) -> None:
    found = inverse(stereo.path[0]) @ stereo.path[-1]
    truth = inverse(recording.world_from_cam0[0]) @ recording.world_from_cam0[-1]
    assert np.rad2deg(rotation_angle((inverse(found) @ truth)[:3, :3])) < 1.0


def test_causal_poses_are_near_the_smoothed_ones(stereo: Run, recording: Recording) -> None:
    for estimate, smoothed in zip(stereo.estimates, stereo.path, strict=True):
        assert estimate.world_from_cam0 is not None
        away = inverse(smoothed) @ estimate.world_from_cam0
        assert np.linalg.norm(away[:3, 3]) < 0.02 * recording.path_m


def test_the_first_pose_is_where_the_world_begins(stereo: Run) -> None:
    first = stereo.estimates[0].world_from_cam0
    assert first is not None
    np.testing.assert_allclose(first, np.eye(4), atol=1e-12)


def test_estimates_and_snapshots_are_consistent(stereo: Run) -> None:
    keyframes = [e for e in stereo.estimates if e.is_keyframe]
    assert 2 <= len(keyframes) < COUNT
    for estimate, snapshot in zip(stereo.estimates, stereo.snapshots, strict=True):
        assert 0 < estimate.inliers <= estimate.matches
        moved = [k.frame_index for k in estimate.keyframes]
        assert moved == sorted(moved) and (estimate.frame_index in moved) == estimate.is_keyframe
        assert (snapshot.landmarks is not None) == bool(moved)
        assert (estimate.landmark_ids is not None) == bool(moved)
        view = snapshot.view
        assert view.xy.shape == view.previous_xy.shape == (len(view.feature_state), 2)
        assert estimate.stage_ms["features"] > 0.0


def test_snapshots_change_no_result_and_agree_with_it(stereo: Run, recording: Recording) -> None:
    plain = track(recording.rig, recording.frames[:15]).estimates
    for ours, other, snapshot in zip(plain, stereo.estimates, stereo.snapshots, strict=False):
        np.testing.assert_array_equal(ours.world_from_cam0, other.world_from_cam0)
        view = snapshot.view
        assert ours.features == len(view.xy)
        assert view.error_px is not None and not np.isnan(view.error_px).all()
        assert (ours.landmark_ids is None) == (snapshot.landmarks is None)
        if ours.landmark_ids is not None and snapshot.landmarks is not None:
            np.testing.assert_array_equal(ours.landmark_ids, snapshot.landmarks.ids)
            assert snapshot.landmarks.sigma is not None
    assert sum(e.is_keyframe for e in plain) > 1
    assert any(s.neighbours for s in stereo.snapshots)


def test_before_the_first_frame_there_is_no_snapshot(recording: Recording) -> None:
    odometry = Odometry(recording.rig, CONFIG)
    with pytest.raises(RuntimeError, match="no frame has been tracked yet"):
        odometry.snapshot()
    odometry.close()


def test_landmarks_lie_inside_the_room(stereo: Run, recording: Recording) -> None:
    landmarks = next(s.landmarks for s in reversed(stereo.snapshots) if s.landmarks is not None)
    xyz = landmarks.xyz @ recording.world_from_cam0[0, :3, :3].T
    xyz = xyz + recording.world_from_cam0[0, :3, 3]
    inside = np.all((xyz > (-5.0, -4.0, -0.5)) & (xyz < (5.0, 4.0, 3.4)), axis=1)
    assert len(landmarks.ids) > 200
    assert inside.mean() > 0.97


@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_every_keyframe_has_a_covariance(kind: str, request: pytest.FixtureRequest) -> None:
    run: Run = request.getfixturevalue(kind)
    covariances = [k.covariance for k in run.odometry.trajectory.keyframes()]
    known = [c for c in covariances if c is not None and np.isfinite(c).all()]
    assert len(known) == len(covariances) > 4
    np.testing.assert_array_equal(known[0], 0.0)
    assert min(np.linalg.eigvalsh(c).min() for c in known[1:]) > 0.0
    turn = [float(np.sqrt(np.trace(c[:3, :3]))) for c in known]
    assert turn[1] < turn[len(turn) // 2] < turn[-1] < np.deg2rad(1.0)


def test_true_poses_lie_within_a_few_sigmas(stereo: Run, recording: Recording) -> None:
    world_from_first = recording.world_from_cam0[0]
    for keyframe in list(stereo.odometry.trajectory.keyframes())[1:]:
        truth = inverse(world_from_first) @ recording.world_from_cam0[keyframe.frame_index]
        assert keyframe.covariance is not None
        error = se3_log(inverse(keyframe.world_from_cam0) @ truth)
        assert np.abs(error / np.sqrt(np.diag(keyframe.covariance))).max() < 6.0


@pytest.mark.parametrize("kind", ["stereo", "mono"])
@pytest.mark.parametrize("threads", [2, 4])
def test_the_number_of_threads_makes_no_difference(
    kind: str, threads: int, request: pytest.FixtureRequest, recording: Recording
) -> None:
    alone: Run = request.getfixturevalue(kind)
    rig = recording.rig if kind == "stereo" else recording.mono_rig
    frames = recording.frames if kind == "stereo" else recording.mono()
    many = track(rig, frames, CONFIG.model_copy(update={"threads": threads}))
    np.testing.assert_array_equal(many.path, alone.path)
    for one, other in zip(many.estimates, alone.estimates, strict=True):
        assert one.state == other.state
        np.testing.assert_array_equal(one.world_from_cam0, other.world_from_cam0)
    covariances = [
        [k.covariance for k in run.odometry.trajectory.keyframes()] for run in (many, alone)
    ]
    np.testing.assert_array_equal(*covariances)


SETTINGS = ["tracking.method=klt", "threads=1"]


@pytest.mark.parametrize("detector", ["shi_tomasi", "fast", "orb"])
@pytest.mark.parametrize("cameras", [1, 2])
def test_the_walk_is_tracked(cameras: int, detector: str, recording: Recording) -> None:
    config = load_config("default", [*SETTINGS, f"features.detector={detector}"])
    rig = recording.rig if cameras == 2 else recording.mono_rig
    frames = recording.frames if cameras == 2 else recording.mono()
    run = track(rig, frames, config)
    missing = sum(e.world_from_cam0 is None for e in run.estimates)
    assert missing <= (0 if cameras == 2 else 6)
    assert not any(f.kind is FaultKind.TWO_MOTIONS for e in run.estimates for f in e.faults)
    rmse_m, _ = aligned(run, recording, with_scale=cameras == 1)
    assert rmse_m < 0.02
