from __future__ import annotations

import numpy as np
import pytest

from data_synth.recipe import Effects
from data_synth.sensor.timing import Timing, make_timing
from vo.base.types import Bools

START_NS = 1_700_000_000_000_000_000
NOTHING = Effects(blur=0, noise=0, exposure=0, vignetting=0)


def _timing(
    effects: Effects, frames: int = 400, fps: float = 20.0, cameras: int = 2, seed: int = 3
) -> Timing:
    return make_timing(
        effects, frames=frames, fps=fps, cameras=cameras, seed=seed, first_stamp_ns=START_NS
    )


def _runs(mask: Bools) -> list[tuple[int, int]]:
    """First and one past the last of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def test_without_effects_stamps_are_exact_and_the_light_is_constant() -> None:
    timing = _timing(NOTHING, frames=100, fps=8.0)
    assert np.array_equal(timing.times_s, np.arange(100) / 8.0)
    for stamps, dropped in zip(timing.stamps_ns, timing.dropped, strict=True):
        assert stamps.dtype == np.int64
        assert np.array_equal(stamps, START_NS + 125_000_000 * np.arange(100))
        assert not dropped.any()
    assert np.all(timing.illumination == 1.0)
    assert not timing.black.any()


def test_light_is_a_factor_of_the_whole_recording() -> None:
    usual, dim = (_timing(Effects(light=light, blackout=40)) for light in (1.0, 0.08))
    assert dim.illumination[0] == 0.08
    assert np.allclose(dim.illumination, 0.08 * usual.illumination)
    assert _runs(dim.black) == [(180, 220)]


@pytest.mark.parametrize("cameras", [1, 2])
def test_there_are_stamps_and_losses_for_each_camera(cameras: int) -> None:
    timing = _timing(Effects(drops=1, jitter=1), cameras=cameras)
    assert len(timing.stamps_ns) == len(timing.dropped) == cameras


@pytest.mark.parametrize("strength", [0.5, 1.0, 4.0])
def test_jitter_has_its_standard_deviation_and_is_mostly_common_to_a_pair(strength: float) -> None:
    timing = _timing(NOTHING.model_copy(update={"jitter": strength}), frames=4000)
    true_ns = START_NS + np.round(timing.times_s * 1e9).astype(np.int64)
    left, right = (np.asarray(s - true_ns, dtype=float) for s in timing.stamps_ns)
    for late_ns in (left, right):
        assert np.std(late_ns) == pytest.approx(0.5e6 * strength, rel=0.1)
        assert abs(np.mean(late_ns)) < 0.05 * 0.5e6 * strength
    apart = np.std(left - right)
    assert 0.3 * 0.5e6 * strength < apart < 0.6 * 0.5e6 * strength


@pytest.mark.parametrize(("strength", "fps"), [(1.0, 20.0), (50.0, 30.0), (50.0, 1000.0)])
def test_stamps_are_strictly_increasing(strength: float, fps: float) -> None:
    for stamps in _timing(Effects(jitter=strength), frames=3000, fps=fps).stamps_ns:
        assert np.all(np.diff(stamps) > 0)


@pytest.mark.parametrize("strength", [1.0, 10.0])
def test_frames_are_lost_by_both_cameras_or_by_one(strength: float) -> None:
    left, right = _timing(Effects(drops=strength), frames=20_000).dropped
    assert np.mean(left) == pytest.approx(0.01 * strength, rel=0.2)
    assert np.mean(right) == pytest.approx(0.01 * strength, rel=0.2)
    assert np.mean(left & right) == pytest.approx(0.005 * strength, rel=0.25)
    assert np.mean(left & ~right) == pytest.approx(0.005 * strength, rel=0.25)


def test_first_frame_is_never_lost() -> None:
    for seed in range(40):
        timing = _timing(Effects(drops=50), frames=5, seed=seed)
        assert not any(camera[0] for camera in timing.dropped)


@pytest.mark.parametrize("count", [1, 5, 40])
def test_blackout_has_the_given_number_of_frames_about_the_middle(count: int) -> None:
    black = _timing(Effects(blackout=count), frames=101).black
    ((first, end),) = _runs(black)
    assert end - first == count
    assert abs((first + end - 1) / 2 - 50) <= 1


def test_blackout_longer_than_the_recording_excludes_the_first_frame() -> None:
    black = _timing(Effects(blackout=50), frames=20).black
    assert not black[0]
    assert black[1:].all()


@pytest.mark.parametrize("strength", [0.5, 1.0, 2.0])
def test_dark_intervals_have_the_documented_depth_length_and_spacing(strength: float) -> None:
    effects = NOTHING.model_copy(update={"dark": strength})
    timing = _timing(effects, frames=12_000, fps=100.0)
    light = timing.illumination
    assert light.max() == 1.0
    assert light.min() == pytest.approx(0.12**strength, rel=1e-6)
    runs = _runs(light < (1.0 + 0.12**strength) / 2.0)[:-1]  # the end may cut the last one
    starts_s = np.array([timing.times_s[first] for first, _ in runs])
    lengths_s = np.array([(end - first) / 100.0 for first, end in runs])
    assert starts_s[0] > 2.0
    assert np.all((lengths_s > 1.5) & (lengths_s < 2.2))
    assert np.all((np.diff(starts_s) > 6.9) & (np.diff(starts_s) < 9.1))
    # A ramp of 0.2 s: never more than 1.5 / 0.2 s of the depth in a second.
    steepest = np.abs(np.diff(light)).max() * 100.0
    assert steepest == pytest.approx(7.5 * (1.0 - 0.12**strength), rel=0.05)


@pytest.mark.parametrize("seed", range(6))
def test_light_drifts_slowly_apart_from_one_or_two_steps(seed: int) -> None:
    effects = NOTHING.model_copy(update={"exposure": 1.0})
    light = np.log(_timing(effects, frames=600, fps=20.0, seed=seed).illumination)
    assert light[0] == 0.0
    changes = np.diff(light)
    sudden = np.abs(changes) > 0.2
    assert 1 <= sudden.sum() <= 2
    assert np.all(np.abs(changes[sudden]) < 1.3 * np.log(1.8))
    assert np.abs(changes[~sudden]).max() < 0.02
    slow = np.concatenate([[0.0], np.cumsum(np.where(sudden, 0.0, changes))])
    assert 0.08 < np.abs(slow).max() < 1.1 * np.log(1.3)


def test_timing_depends_on_the_seed_and_effects_are_independent() -> None:
    effects = Effects(drops=3, jitter=1, dark=1)
    first, again, other = _timing(effects), _timing(effects), _timing(effects, seed=4)
    for a, b, c in zip(first.stamps_ns, again.stamps_ns, other.stamps_ns, strict=True):
        assert np.array_equal(a, b)
        assert not np.array_equal(a, c)
    assert np.array_equal(first.illumination, again.illumination)
    assert not np.array_equal(first.illumination, other.illumination)
    without = _timing(Effects(drops=3))
    for a, b in zip(first.dropped, without.dropped, strict=True):
        assert np.array_equal(a, b)
