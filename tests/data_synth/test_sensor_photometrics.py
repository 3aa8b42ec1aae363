from __future__ import annotations

import numpy as np
import pytest

from data_synth.recipe import Effects
from data_synth.sensor.exposure import Settings
from data_synth.sensor.photometrics import FULL_WELL, develop, read_noise, vignetting
from vo.base.types import Bytes, Camera, Floats32

PERFECT = Effects(blur=0, noise=0, exposure=0, vignetting=0)
CAMERA = Camera(752, 480, 458.0, 457.0, 367.2, 248.4)


def _rng(frame: int = 0) -> np.random.Generator:
    return np.random.default_rng([0, 2, frame, 0])


def _even(radiance: float) -> Floats32:
    return np.full((300, 400), radiance, np.float32)


def _ramp() -> Floats32:
    return np.random.default_rng(1).uniform(-0.02, 1.1, (120, 160)).astype(np.float32)


def test_perfect_camera_gives_the_radiance_in_grey_levels() -> None:
    radiance = _ramp()
    image = develop(radiance, Settings(), PERFECT, 1.0, vignetting(CAMERA_SMALL, 0.0), _rng())
    expected = np.clip(np.round(np.float32(255.0) * radiance), 0, 255).astype(np.uint8)
    assert np.array_equal(image, expected)
    assert np.array_equal(image, develop(radiance, Settings(), PERFECT, 1.0, None, _rng()))


CAMERA_SMALL = Camera(160, 120, 100.0, 100.0, 80.0, 60.0)


@pytest.mark.parametrize("gain", [1.0, 4.0])
@pytest.mark.parametrize("strength", [1.0, 3.0])
def test_variance_is_linear_in_the_signal(gain: float, strength: float) -> None:
    effects = PERFECT.model_copy(update={"noise": strength})
    settings = Settings(4e-3, gain, gain)
    levels = np.linspace(70.0, 180.0, 9)
    images = [
        develop(_even(level / 255.0 / gain), settings, effects, 1.0, None, _rng(i)).astype(float)
        for i, level in enumerate(levels)
    ]
    assert np.allclose([i.mean() for i in images], levels, atol=0.2)
    # Quantisation adds 1/12. The error of a measured variance is proportional to the variance.
    variances = np.array([i.var() for i in images]) - 1.0 / 12.0
    slope, offset = np.polyfit(levels, variances, 1, w=1.0 / variances)
    assert slope == pytest.approx(strength**2 * 255.0 * gain / FULL_WELL, rel=0.05)
    line = strength**2 * (read_noise(gain) ** 2 + 255.0 * gain / FULL_WELL * levels)
    assert np.allclose(variances, line, rtol=0.05)
    assert abs(offset - (strength * read_noise(gain)) ** 2) < 0.1 * line[0]


def test_noise_is_2_grey_levels_at_mid_grey_and_less_than_1_in_the_dark() -> None:
    image = develop(_even(0.5), Settings(), Effects(), 1.0, None, _rng())
    assert 1.9 < image.std() < 2.4
    assert read_noise(1.0) == pytest.approx(0.8, abs=0.05)


@pytest.mark.parametrize("gain", [1.0, 16.0])
def test_black_frame_contains_read_noise_only(gain: float) -> None:
    effects = PERFECT.model_copy(update={"noise": 1.0})
    image = develop(_ramp(), Settings(8e-3, gain, gain), effects, 0.0, None, _rng())
    # What is below zero is cut off: a half of a Gaussian, whose mean is sigma / sqrt(2 pi).
    factor = image.mean() / (read_noise(gain) / np.sqrt(2.0 * np.pi))
    assert factor == pytest.approx(1.0, abs=0.1)
    assert image.max() < 6.0 * read_noise(gain)
    assert not develop(_ramp(), Settings(), PERFECT, 0.0, None, _rng()).any()


def test_brightness_follows_light_and_response() -> None:
    def mean(light: float, response: float) -> float:
        settings = Settings(4e-3, 1.0, response)
        return float(develop(_even(0.2), settings, PERFECT, light, None, _rng()).mean())

    assert mean(1.0, 2.0) == mean(2.0, 1.0) == mean(0.5, 4.0) == 102.0
    assert mean(3.0, 3.0) == 255.0


@pytest.mark.parametrize("strength", [0.5, 1.0, 3.0])
def test_corners_are_darker_by_a_quarter_times_strength(strength: float) -> None:
    factor = vignetting(CAMERA, strength)
    assert factor.shape == (480, 752) and factor.dtype == np.float32
    corners = [factor[v, u] for v in (0, -1) for u in (0, -1)]
    assert min(corners) == factor.min() == pytest.approx(1.0 - 0.25 * strength, abs=1e-5)
    assert max(corners) < 1.0 - 0.2 * strength
    assert factor[248, 367] == pytest.approx(1.0, abs=1e-5)
    assert np.all(np.diff(factor[248, 368:]) < 0.0)
    image = develop(np.full((480, 752), 0.8, np.float32), Settings(), PERFECT, 1.0, factor, _rng())
    assert np.array_equal(image, np.round(np.float32(255.0 * 0.8) * factor).astype(np.uint8))


@pytest.mark.parametrize("strength", [0.3, 1.0, 2.0])
def test_gamma_is_a_power_of_the_light(strength: float) -> None:
    radiance = np.linspace(0.0, 1.0, 400, dtype=np.float32)[None]
    effects = PERFECT.model_copy(update={"gamma": strength})
    image = develop(radiance, Settings(), effects, 1.0, None, _rng())
    expected = 255.0 * radiance.astype(float) ** (1.0 / (1.0 + 1.2 * strength))
    assert np.abs(image - expected).max() < 0.6
    assert image[0, 0] == 0 and image[0, -1] == 255


def test_noise_depends_on_the_random_generator_only() -> None:
    def image(frame: int) -> Bytes:
        return develop(_ramp(), Settings(), Effects(), 1.0, None, _rng(frame))

    assert np.array_equal(image(0), image(0))
    assert not np.array_equal(image(0), image(1))


def test_noise_is_normal_and_independent_between_pixels_and_frames() -> None:
    effects = PERFECT.model_copy(update={"noise": 5.0})
    first, second = (
        develop(_even(0.5), Settings(), effects, 1.0, None, _rng(frame)).astype(float)
        for frame in (0, 1)
    )
    first, second = (first - first.mean()) / first.std(), (second - second.mean()) / second.std()
    spread = 1.0 / np.sqrt(first.size)  # of a mean of products of independent normal numbers
    assert abs((first**3).mean()) < 5.0 * np.sqrt(15.0) * spread
    assert abs((first**4).mean() - 3.0) < 5.0 * np.sqrt(96.0) * spread
    assert np.abs(first).max() > 4.0
    for apart in (1, 2, 3, 4, 8):
        assert abs((first[:, apart:] * first[:, :-apart]).mean()) < 5.0 * spread
        assert abs((first[apart:] * first[:-apart]).mean()) < 5.0 * spread
    assert abs((first * second).mean()) < 5.0 * spread
