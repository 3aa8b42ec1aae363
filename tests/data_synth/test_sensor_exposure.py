from __future__ import annotations

import numpy as np
import pytest

from data_synth.recipe import Effects
from data_synth.sensor.exposure import (
    TARGET,
    AutoExposure,
    Settings,
    longest_exposure_s,
    readout_s,
    target_mean,
)
from data_synth.sensor.photometrics import develop
from vo.base.types import Floats

FPS = 20.0


def _exposed(
    effects: Effects, light: Floats, radiance: float = 0.35, fps: float = FPS
) -> tuple[list[Settings], Floats]:
    """Settings and means of the images of an even scene."""
    exposure = AutoExposure(effects, fps, radiance)
    taken, means = [], []
    for now in light:
        taken.append(exposure.next())
        grey = min(1.0, radiance * now * taken[-1].response)
        means.append(grey ** (1.0 / (1.0 + 1.2 * effects.gamma)))
        exposure.observe(means[-1])
    return taken, np.array(means)


@pytest.mark.parametrize("gamma", [0.0, 1.0])
@pytest.mark.parametrize("radiance", [0.1, 0.35, 0.8])
def test_first_images_meet_the_target(gamma: float, radiance: float) -> None:
    effects = Effects(gamma=gamma)
    _, means = _exposed(effects, np.ones(40), radiance)
    assert np.allclose(means, target_mean(effects), rtol=1e-6)
    assert target_mean(Effects()) == TARGET < target_mean(Effects(gamma=1)) < 0.55


@pytest.mark.parametrize("change", [0.4, 1.15])
def test_exposure_lags_behind_a_step_of_light_then_settles(change: float) -> None:
    light = np.ones(100)
    light[20:] = change
    _, means = _exposed(Effects(), light)
    # The image of frame 20 is used from frame 22 on; one time constant of 0.25 s is 5 frames.
    assert means[20] == means[21] == pytest.approx(change * TARGET)
    left = np.log(means[20:] / TARGET) / np.log(means[20] / TARGET)
    assert left[2] < 0.9
    assert left[1 + 5] == pytest.approx(np.exp(-1.0), abs=0.02)
    assert abs(means[20 + 30] - TARGET) < 0.01
    assert np.all(np.diff(left[1:]) <= 0.0) and left.min() > -0.01  # it never overshoots


def test_exposure_recovers_from_clipped_and_black_images() -> None:
    scene = np.linspace(0.0, 0.7, 4096, dtype=np.float32)[None]
    light = np.ones(160)
    light[20:80] = 6.0
    light[120:125] = 0.0
    exposure, means = AutoExposure(Effects(), FPS, 0.35), []
    for frame, now in enumerate(light):
        image = develop(scene, exposure.next(), Effects(), now, None, np.random.default_rng(frame))
        means.append(float(image.mean()) / 255.0)
        exposure.observe(means[-1])
    assert means[20] > 0.85
    assert abs(means[20 + 25] - TARGET) < 0.05  # 1.25 s after the light rose sixfold
    assert max(means[120:125]) < 0.01
    assert 0.7 < means[125] < 0.95  # it opened up in the dark,
    assert abs(means[125 + 15] - TARGET) < 0.05  # which is undone after 0.75 s


def test_lag_of_exposure_grows_with_strength() -> None:
    light = np.ones(200)
    light[20:] = 0.5
    counts = [
        int(np.argmax(_exposed(Effects(exposure=e), light)[1][20:] > 0.9 * TARGET))
        for e in (0.2, 1.0, 3.0)
    ]
    assert counts[0] <= 4
    assert counts[1] == pytest.approx(2 + 5 * np.log(np.log(2) / -np.log(0.9)), abs=2)
    assert counts[2] == pytest.approx(2 + 15 * np.log(np.log(2) / -np.log(0.9)), abs=3)


def test_exposure_is_fixed_without_the_effect() -> None:
    light = np.linspace(1.0, 0.2, 30)
    taken, means = _exposed(Effects(exposure=0), light)
    assert len(set(taken)) == 1
    assert np.allclose(means, TARGET * light)


def test_exposure_time_rises_before_gain_and_gain_is_at_most_16() -> None:
    light = np.concatenate([np.full(60, x) for x in (1.0, 4.0, 0.3, 0.001)])
    taken, _ = _exposed(Effects(), light, radiance=0.4)
    normal, bright, dim, night = (taken[i] for i in (59, 119, 179, 239))
    assert normal.gain == 1.0 and 5e-3 < normal.exposure_s < 8e-3
    assert bright.gain == 1.0
    assert bright.exposure_s == pytest.approx(normal.exposure_s / 4.0, rel=0.01)
    assert dim.exposure_s == pytest.approx(8e-3)
    assert dim.gain == pytest.approx(0.3 / (0.4 * 0.3), rel=0.02)
    assert night.exposure_s == pytest.approx(8e-3)
    assert night.gain == pytest.approx(16.0, rel=0.02)
    for settings in taken:
        assert 1.0 <= settings.gain <= 16.0 * (1.0 + 1e-9)
        assert settings.response == pytest.approx(
            settings.exposure_s / taken[0].exposure_s * settings.gain * taken[0].response
        )


def test_blur_strength_changes_exposure_time_but_not_brightness() -> None:
    for blur in (0.0, 0.5, 2.0):
        (settings,), means = _exposed(Effects(blur=blur), np.ones(1), radiance=0.3)
        assert settings.exposure_s == pytest.approx(8e-3 * blur)
        assert means[0] == pytest.approx(TARGET)


def test_exposure_and_readout_fit_between_frames() -> None:
    effects = Effects(blur=10, rolling_shutter=5)
    assert longest_exposure_s(effects, 60.0) == pytest.approx(0.9 / 60.0)
    assert readout_s(effects, 60.0) == pytest.approx(0.9 / 60.0)
    assert longest_exposure_s(Effects(), 60.0) == pytest.approx(8e-3)
    assert readout_s(Effects(rolling_shutter=0.5), 60.0) == pytest.approx(10e-3)
    assert readout_s(Effects(), 60.0) == 0.0


def test_image_means_may_arrive_one_frame_late() -> None:
    means = [0.42, 0.2, 0.9, 0.5, 0.3, 0.42]
    prompt, late = (AutoExposure(Effects(), FPS, 0.35) for _ in range(2))
    taken = []
    for mean in means:
        taken.append(prompt.next())
        prompt.observe(mean)
    taken_late = [late.next()]
    for mean in means[:-1]:
        taken_late.append(late.next())
        late.observe(mean)
    assert taken_late == taken
    late.next()
    with pytest.raises(RuntimeError, match="frame 7 needs the mean of frame 5"):
        late.next()


def test_frames_without_an_image_change_nothing() -> None:
    exposure = AutoExposure(Effects(), FPS, 0.35)
    taken = []
    for _ in range(10):
        taken.append(exposure.next())
        exposure.observe(None)
    assert len(set(taken)) == 1
