"""From rendered images to the path, end to end."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
import pytest

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from vo.backend.optimizer import InProcessOptimizer
from vo.backend.window_problem import WindowProblem
from vo.config import Config, FeaturesConfig, KeyframeConfig
from vo.geometry.similarity import Similarity, umeyama
from vo.geometry.transforms import inverse, rotation_angle, se3_log
from vo.odometry import Odometry
from vo.types import Estimate, Floats, Frame, Rig, Snapshot, State

FPS, FIRST, COUNT = 15.0, 15, 40  # a second after the start, when the walk is under way
CONFIG = Config(threads=1, features=FeaturesConfig(count=800))  # enough for small images
Change = Callable[[Frame], Frame]


@dataclass(frozen=True, eq=False)
class Recording:
    """A stereo walk through a room with its true poses."""

    rig: Rig
    frames: tuple[Frame, ...]
    world_from_cam0: Floats

    @property
    def mono_rig(self) -> Rig:
        return Rig(self.rig.cam0)

    def mono(self) -> list[Frame]:
        return [replace(f, images=f.images[:1]) for f in self.frames]

    @property
    def path_m(self) -> float:
        steps = np.diff(self.world_from_cam0[:, :3, 3], axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())


@dataclass(frozen=True, eq=False)
class Run:
    """Results of the odometry, frame by frame, and its path at the end."""

    odometry: Odometry
    estimates: list[Estimate]
    snapshots: list[Snapshot]  # empty unless they were asked for

    @property
    def states(self) -> list[State]:
        return [e.state for e in self.estimates]

    @property
    def path(self) -> Floats:
        return self.odometry.trajectory.trajectory().world_from_cam

    @property
    def numbers(self) -> list[int]:
        """Frames that have a pose."""
        return [int(f) for f in self.odometry.trajectory.frames["frame_index"]]

    def segment(self, number: int) -> list[int]:
        frames = self.odometry.trajectory.frames
        return [int(f) for f in frames["frame_index"][frames["segment"] == number]]


@pytest.fixture(scope="module")
def recording() -> Recording:
    return _recording()


@cache
def _recording() -> Recording:
    settings = ["effects.exposure=0", "effects.blur=0", "effects.vignetting=0"]
    recipe = load_recipe("demo", [*settings, "motion=handheld", "seconds=4", "scale=0.75"])
    plan = make_plan(recipe)
    frames = []
    with ThreadPoolExecutor() as pool:
        for shot in render_frames(plan, pool, range(FIRST, FIRST + COUNT)):
            index = len(frames)
            left, right = shot.images
            assert left is not None
            frames.append(Frame(index, round(index / FPS * 1e9), (left, right)))
    poses = plan.recording.cam0_truth.world_from_cam[FIRST : FIRST + COUNT]
    return Recording(plan.recording.rig, tuple(frames), poses)


def _run(
    rig: Rig, frames: Iterable[Frame], config: Config = CONFIG, *, takes_snapshots: bool = False
) -> Run:
    odometry = Odometry(rig, config)
    run = Run(odometry, [], [])
    for estimate in odometry.track_all(frames):
        run.estimates.append(estimate)
        if takes_snapshots:
            run.snapshots.append(odometry.snapshot())
    odometry.finish()
    odometry.close()
    return run


@pytest.fixture(scope="module")
def stereo(recording: Recording) -> Run:
    return _run(recording.rig, recording.frames, takes_snapshots=True)


@pytest.fixture(scope="module")
def mono(recording: Recording) -> Run:
    return _run(recording.mono_rig, recording.mono())


def _fit(run: Run, recording: Recording, *, with_scale: bool) -> tuple[float, Similarity]:
    """Root mean square of position errors after alignment, and the alignment."""
    truth = recording.world_from_cam0[run.numbers][:, :3, 3]
    fit = umeyama(run.path[:, :3, 3], truth, with_scale=with_scale)
    errors = fit.transform_points(run.path[:, :3, 3]) - truth
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))), fit


def _change(frames: Iterable[Frame], numbers: Iterable[int], change: Change) -> list[Frame]:
    chosen = set(numbers)
    return [change(f) if f.index in chosen else f for f in frames]


def _black(frame: Frame) -> Frame:
    dark = np.zeros_like(frame.image0)
    return replace(frame, images=(dark, None if frame.image1 is None else dark))


# A stereo walk


def test_stereo_tracks_every_frame_in_one_segment(stereo: Run) -> None:
    assert set(stereo.states) == {State.TRACKING}
    assert stereo.numbers == list(range(COUNT))
    assert {e.segment for e in stereo.estimates} == {0}
    assert all(e.failure is None for e in stereo.estimates)


def test_stereo_errs_by_less_than_a_hundredth_of_the_path(
    stereo: Run, recording: Recording
) -> None:
    ate, _ = _fit(stereo, recording, with_scale=False)
    assert ate < 0.01 * recording.path_m


def test_stereo_scale_is_true_to_one_percent(stereo: Run, recording: Recording) -> None:
    _, fit = _fit(stereo, recording, with_scale=True)
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
    plain = _run(recording.rig, recording.frames[:15]).estimates
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


def test_stereo_is_bit_identical_when_run_again(stereo: Run, recording: Recording) -> None:
    again = _run(recording.rig, recording.frames)
    np.testing.assert_array_equal(again.path, stereo.path)


@pytest.mark.parametrize("kind", ["stereo", "mono"])
@pytest.mark.parametrize("threads", [2, 4])
def test_the_number_of_threads_makes_no_difference(
    kind: str, threads: int, request: pytest.FixtureRequest, recording: Recording
) -> None:
    alone: Run = request.getfixturevalue(kind)
    rig = recording.rig if kind == "stereo" else recording.mono_rig
    frames = recording.frames if kind == "stereo" else recording.mono()
    many = _run(rig, frames, CONFIG.model_copy(update={"threads": threads}))
    np.testing.assert_array_equal(many.path, alone.path)
    for one, other in zip(many.estimates, alone.estimates, strict=True):
        assert one.state == other.state
        np.testing.assert_array_equal(one.world_from_cam0, other.world_from_cam0)
    covariances = [
        [k.covariance for k in run.odometry.trajectory.keyframes()] for run in (many, alone)
    ]
    np.testing.assert_array_equal(*covariances)


# Disparity offset


def _with_shifted_right(frames: Iterable[Frame], shift_px: float) -> list[Frame]:
    """The right image is moved to the left, so that every disparity grows by `shift_px`."""
    move = np.array([[1.0, 0.0, -shift_px], [0.0, 1.0, 0.0]])
    result = []
    for frame in frames:
        assert frame.image1 is not None
        image1 = cv2.warpAffine(
            frame.image1,
            move,
            (480, 300),
            flags=cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        )
        result.append(replace(frame, images=(frame.image0, np.asarray(image1, dtype=np.uint8))))
    return result


def test_without_a_disparity_offset_none_is_found(stereo: Run) -> None:
    assert abs(stereo.odometry.calibration_errors.disparity_offset_px) < 0.1


@pytest.mark.parametrize("shift_px", [0.5, -0.5])
def test_a_disparity_offset_is_found_and_corrected(recording: Recording, shift_px: float) -> None:
    run = _run(recording.rig, _with_shifted_right(recording.frames[:30], shift_px))
    assert run.odometry.calibration_errors.disparity_offset_px == pytest.approx(shift_px, abs=0.15)
    _, fit = _fit(run, recording, with_scale=True)
    assert fit.scale == pytest.approx(1.0, abs=0.02)


def test_a_disparity_offset_is_not_corrected_if_switched_off(
    recording: Recording,
) -> None:
    refinement = CONFIG.refinement.model_copy(update={"disparity_correction": False})
    frames = _with_shifted_right(recording.frames[:15], 0.5)
    run = _run(recording.rig, frames, CONFIG.model_copy(update={"refinement": refinement}))
    assert run.odometry.calibration_errors.disparity_offset_px == 0.0
    _, fit = _fit(run, recording, with_scale=True)
    assert abs(fit.scale - 1.0) > 0.01  # so the shift is one that matters


def test_calibration_is_estimated_in_each_of_ten_windows_and_then_in_every_third(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimated = _estimated(monkeypatch)
    often = KeyframeConfig(max_gap_s=1e-3, min_parallax_deg=0.05)  # so that there are enough
    _run(recording.rig, recording.frames, CONFIG.model_copy(update={"keyframes": often}))
    assert len(estimated) > 20
    assert estimated[:10] == [True] * 10
    assert estimated[10:] == [number % 3 == 0 for number in range(10, len(estimated))]


@pytest.mark.parametrize(
    ("mode", "setting"), [("stereo", "disparity_correction"), ("mono", "lens_correction")]
)
def test_calibration_is_not_estimated_if_its_correction_is_switched_off(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, mode: str, setting: str
) -> None:
    estimated = _estimated(monkeypatch)
    refinement = CONFIG.refinement.model_copy(update={setting: False})
    rig = recording.rig if mode == "stereo" else recording.mono_rig
    frames = recording.frames[:15] if mode == "stereo" else recording.mono()[:25]
    _run(rig, frames, CONFIG.model_copy(update={"refinement": refinement}))
    assert estimated
    assert not any(estimated)


def _estimated(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether the calibration is estimated in each window that is submitted from here on."""
    estimated: list[bool] = []
    submit = InProcessOptimizer.submit

    def noted(self: InProcessOptimizer, problem: WindowProblem) -> None:
        estimated.append(problem.estimates_calibration)
        submit(self, problem)

    monkeypatch.setattr(InProcessOptimizer, "submit", noted)
    return estimated


# Lens


def _with_k1(recording: Recording, k1: float) -> Rig:
    """A calibration that is wrong by k1: the lens of the recording has no distortion."""
    cam0 = recording.rig.cam0
    return Rig(replace(cam0, distortion_model="radtan", distortion=(k1, 0.0, 0.0, 0.0)))


def test_a_lens_that_is_as_calibrated_is_not_corrected(mono: Run) -> None:
    assert mono.odometry.calibration_errors.lens_error is None


@pytest.mark.parametrize("k1", [-0.02, -0.01, 0.02])
def test_an_error_of_the_lens_is_found_and_corrected(
    recording: Recording, mono: Run, k1: float
) -> None:
    run = _run(_with_k1(recording, k1), recording.mono())
    found = run.odometry.calibration_errors.lens_error
    assert found is not None
    assert found.k1 == pytest.approx(-k1, rel=0.1)  # three pixels in the corners, or six
    radius = np.hypot(240.0, 150.0) / 264.0
    assert found.edge_px == pytest.approx(found.k1 * 264.0 * radius**3, rel=0.1)
    ate, _ = _fit(run, recording, with_scale=True)
    right, _ = _fit(mono, recording, with_scale=True)
    assert ate < 3.0 * right


def test_a_lens_is_not_corrected_if_switched_off(recording: Recording, mono: Run) -> None:
    refinement = CONFIG.refinement.model_copy(update={"lens_correction": False})
    config = CONFIG.model_copy(update={"refinement": refinement})
    run = _run(_with_k1(recording, 0.02), recording.mono(), config)
    assert run.odometry.calibration_errors.lens_error is None
    ate, _ = _fit(run, recording, with_scale=True)
    right, _ = _fit(mono, recording, with_scale=True)
    assert ate > 6.0 * right  # so the error is one that matters


# A mono walk


def test_mono_tracks_on_once_it_has_started(mono: Run) -> None:
    started = mono.states.index(State.TRACKING)
    assert started < 15  # a second
    assert set(mono.states[:started]) <= {State.STARTING}
    assert set(mono.states[started:]) == {State.TRACKING}
    assert set(range(started, COUNT)) <= set(mono.numbers)
    assert {e.segment for e in mono.estimates} == {0}


def test_mono_errs_by_less_than_a_hundredth_of_the_path(mono: Run, recording: Recording) -> None:
    ate, _ = _fit(mono, recording, with_scale=True)
    assert ate < 0.01 * recording.path_m


def test_mono_is_bit_identical_when_run_again(mono: Run, recording: Recording) -> None:
    again = _run(recording.mono_rig, recording.mono())
    np.testing.assert_array_equal(again.path, mono.path)


def test_frames_before_the_mono_start_have_a_failure(mono: Run) -> None:
    for estimate in mono.estimates:
        assert (estimate.failure is not None) == (estimate.state is State.STARTING)


def test_a_right_image_is_ignored_by_a_mono_rig(mono: Run, recording: Recording) -> None:
    run = _run(recording.mono_rig, recording.frames[:15])
    np.testing.assert_array_equal(
        [e.world_from_cam0 is None for e in run.estimates],
        [e.world_from_cam0 is None for e in mono.estimates[:15]],
    )


def test_standing_still_in_mono_never_makes_a_map(recording: Recording) -> None:
    rng = np.random.default_rng(0)
    still = recording.frames[0].image0.astype(np.int16)
    frames = []
    for index in range(25):
        noisy = still + np.round(rng.normal(0, 3, still.shape)).astype(np.int16)
        image = np.clip(noisy, 0, 255).astype(np.uint8)
        frames.append(Frame(index, index * 66_000_000, (image,)))
    run = _run(recording.mono_rig, frames)
    assert set(run.states) == {State.STARTING}
    assert run.numbers == []
    assert all(e.failure for e in run.estimates)


def test_turning_on_the_spot_in_mono_never_makes_a_map(recording: Recording) -> None:
    matrix = recording.rig.cam0.matrix
    frames = []
    for index in range(20):
        turn = cv2.Rodrigues(np.array([0.0, 0.012 * index, 0.0]))[0]
        move = matrix @ turn @ np.linalg.inv(matrix)
        image = cv2.warpPerspective(recording.frames[0].image0, move, (480, 300))
        frames.append(Frame(index, index * 66_000_000, (np.asarray(image, dtype=np.uint8),)))
    assert _run(recording.mono_rig, frames).numbers == []


# Trouble on the way


def test_a_short_blackout_is_lost_and_then_recovered(recording: Recording) -> None:
    run = _run(recording.rig, _change(recording.frames, range(20, 24), _black))
    assert set(run.states[20:24]) == {State.LOST}
    assert all(e.world_from_cam0 is None and e.failure for e in run.estimates[20:24])
    assert set(run.states[:20] + run.states[24:]) == {State.TRACKING}
    assert run.numbers == [*range(20), *range(24, COUNT)]
    assert {e.segment for e in run.estimates} == {0}
    ate, _ = _fit(run, recording, with_scale=False)
    assert ate < 0.01 * recording.path_m


def test_a_long_blackout_begins_a_new_segment_and_keeps_the_old_poses(
    recording: Recording, stereo: Run
) -> None:
    run = _run(recording.rig, _change(recording.frames, range(10, 30), _black))
    assert run.segment(0) == list(range(10))
    assert run.segment(1) == list(range(30, COUNT))
    assert State.LOST in run.states[10:30] and State.TRACKING not in run.states[10:30]
    assert set(run.states[30:]) == {State.TRACKING}
    assert all(e.world_from_cam0 is None for e in run.estimates[10:30])
    np.testing.assert_allclose(run.path[:8], stereo.path[:8], atol=0.02)


def test_a_blackout_in_mono_keeps_what_there_is(recording: Recording) -> None:
    run = _run(recording.mono_rig, _change(recording.mono(), range(18, 22), _black))
    assert set(run.states[18:22]) == {State.LOST}
    assert not set(run.numbers) & set(range(18, 22))
    assert run.states[-1] is State.TRACKING
    assert len(run.numbers) > 25


def test_only_black_frames_end_without_a_path(recording: Recording) -> None:
    for rig, frames in ((recording.rig, recording.frames), (recording.mono_rig, recording.mono())):
        run = _run(rig, [_black(f) for f in frames[:5]])
        assert set(run.states) == {State.STARTING}
        assert run.numbers == [] and run.path.shape == (0, 4, 4)


def test_frames_without_a_right_image_are_tracked_all_the_same(recording: Recording) -> None:
    left_only = range(10, 22)
    frames = _change(recording.frames[:28], left_only, lambda f: replace(f, images=f.images[:1]))
    run = _run(recording.rig, frames, takes_snapshots=True)
    assert set(run.states) == {State.TRACKING}
    assert run.numbers == list(range(28))
    ate, _ = _fit(run, recording, with_scale=False)
    assert ate < 0.02 * recording.path_m
    for number in left_only:
        assert run.snapshots[number].view.image1 is None


def test_stereo_waits_for_a_right_image_to_start(recording: Recording) -> None:
    frames = _change(recording.frames[:6], range(3), lambda f: replace(f, images=f.images[:1]))
    run = _run(recording.rig, frames)
    assert run.states == [State.STARTING] * 3 + [State.TRACKING] * 3
    assert run.numbers == [3, 4, 5]


def test_a_jump_in_time_and_place_does_not_make_a_wild_path(recording: Recording) -> None:
    frames = [f for f in recording.frames if not 15 <= f.index < 22]
    run = _run(recording.rig, frames)
    steps = np.linalg.norm(np.diff(run.path[:, :3, 3], axis=0), axis=1)
    truth = recording.world_from_cam0[run.numbers][:, :3, 3]
    expected = np.linalg.norm(np.diff(truth, axis=0), axis=1)
    together = np.diff(run.odometry.trajectory.frames["segment"]) == 0
    np.testing.assert_allclose(steps[together], expected[together], atol=0.03)


@pytest.mark.parametrize("kind", ["stereo", "mono"])
def test_frames_that_were_lost_are_tracked_in_the_new_segment(
    recording: Recording, kind: str
) -> None:
    """From one frame to the next the camera is in another place: the room in a mirror."""

    def mirrored(frame: Frame) -> Frame:
        assert frame.image1 is not None
        pair = [np.ascontiguousarray(i[:, ::-1]) for i in (frame.image1, frame.image0)]
        return replace(frame, images=tuple(pair))

    frames = _change(recording.frames, range(14, COUNT), mirrored)
    rig = recording.rig
    if kind == "mono":
        rig, frames = recording.mono_rig, [replace(f, images=f.images[:1]) for f in frames]
    patience = CONFIG.tracking.model_copy(update={"recover_frames": 5})
    run = _run(rig, frames, CONFIG.model_copy(update={"tracking": patience}))
    assert run.states[14:19] == [State.LOST] * 5
    assert run.segment(1) == list(range(14, COUNT))
    assert all(run.estimates[n].world_from_cam0 is None for n in range(14, 19))
    stamps_ns = run.odometry.trajectory.trajectory().stamps_ns
    assert np.all(np.diff(stamps_ns) > 0)


def test_five_dropped_frames_are_bridged(recording: Recording) -> None:
    dropped = range(15, 20)
    run = _run(recording.rig, [f for f in recording.frames if f.index not in dropped])
    assert set(run.states) == {State.TRACKING}
    assert {e.segment for e in run.estimates} == {0}
    assert run.numbers == [n for n in range(COUNT) if n not in dropped]
    ate, _ = _fit(run, recording, with_scale=False)
    assert ate < 0.01 * recording.path_m


def test_a_change_of_exposure_is_survived(recording: Recording) -> None:
    def darker(frame: Frame) -> Frame:
        assert frame.image1 is not None
        pair = [np.round(0.6 * i + 15.0).astype(np.uint8) for i in (frame.image0, frame.image1)]
        return replace(frame, images=tuple(pair))

    run = _run(recording.rig, _change(recording.frames[:28], range(14, 28), darker))
    assert set(run.states) == {State.TRACKING}
    ate, _ = _fit(run, recording, with_scale=False)
    assert ate < 0.015 * recording.path_m
