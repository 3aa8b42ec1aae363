"""Exposure time and gain: fixed, or by auto-exposure with a lag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.recipe import Effects
from vo.base.types import Floats

TARGET = 0.42  # mean of an image, of full scale, if grey levels are linear in light
_NORMAL_RADIANCE = 0.3  # mean radiance that needs the longest exposure at gain 1
_LONGEST_S = 8e-3
_READOUT_S = 20e-3
_MAX_OF_FRAME = 0.9
_MAX_GAIN = 16.0
_SHORTEST = 1.0 / 400.0  # of the longest exposure
_LAG_S = 0.25
_MAX_CHANGE = 4.0  # factor by which one image can change the exposure
_MAX_LIGHT = 2.0  # largest mean light estimated from a clipped image, of full scale


@dataclass(frozen=True)
class Settings:
    """Exposure of one image; the defaults map radiance 0…1 to the full scale of grey levels."""

    exposure_s: float = 0.0
    gain: float = 1.0  # amplification of the signal, and of its noise
    # fraction of full scale, before the gamma curve, for radiance 1 in the light of the start:
    # exposure time / reference exposure time * gain
    response: float = 1.0


def longest_exposure_s(effects: Effects, fps: float) -> float:
    """Longest exposure time of auto-exposure."""
    return min(_LONGEST_S * effects.blur, _MAX_OF_FRAME / fps)


def readout_s(effects: Effects, fps: float) -> float:
    """Time from the exposure of the first row to that of the last."""
    return min(_READOUT_S * effects.rolling_shutter, _MAX_OF_FRAME / fps)


def grey_exponent(effects: Effects) -> float:
    """Exponent of the gamma curve from light to grey levels, both 0…1; 1/2.2 at strength 1."""
    return 1.0 / (1.0 + 1.2 * effects.gamma)


def target_mean(effects: Effects) -> float:
    """Target of auto-exposure for the mean of images, of full scale.

    A gamma curve raises it in part: 0.53 for x^(1/2.2). At 0.42 the bright half of the scale would
    be empty; at the same light as without a curve, images would be pale.
    """
    return float(TARGET ** (0.5 + 0.5 * grey_exponent(effects)))


class AutoExposure:
    """Exposure of each frame from the means of earlier images.

    The settings of frame k depend on images up to k - 2, even if k - 1 has been observed already,
    so that two frames can be rendered at the same time. They follow the light with a time constant
    of 0.25 s at strength 1; at 0 they are constant, chosen for the first view.

    Both cameras of a pair share one instance, as in stereo cameras.
    """

    def __init__(self, effects: Effects, fps: float, radiance_mean: float) -> None:
        """Start with the settings for a given view.

        `fps`: frames per second. `radiance_mean`: mean radiance of the first view, vignetting
        included.
        """
        lag = _LAG_S * effects.exposure * fps
        self._step = 1.0 - float(np.exp(-1.0 / lag)) if lag > 0.0 else 0.0
        self._exponent = grey_exponent(effects)
        self._longest_s = longest_exposure_s(effects, fps)
        self._target = target_mean(effects) ** (1.0 / self._exponent)
        self._full = self._target / _NORMAL_RADIANCE  # response of the longest exposure at gain 1
        self._log_target = self._log_limited(self._target / max(radiance_mean, 1e-6))
        self._log_used: list[float] = []
        self._means: list[float | None] = []
        self._followed = 0

    def next(self) -> Settings:
        """Settings of the next frame.

        Raises:
            RuntimeError: the image two frames before has not been observed.
        """
        frame = len(self._log_used)
        if len(self._means) < frame - 1:
            raise RuntimeError(f"frame {frame} needs the mean of frame {frame - 2}")
        while self._followed < frame - 1:
            self._follow(self._followed)
            self._followed += 1
        self._log_used.append(self._log_target)
        response = float(np.exp(self._log_target))
        ratio = response / self._full
        return Settings(min(1.0, ratio) * self._longest_s, max(1.0, ratio), response)

    def observe(self, image_mean: float | None) -> None:
        """Take the mean of the next image, 0…1 of full scale; None for a missing image."""
        self._means.append(image_mean)

    def _follow(self, frame: int) -> None:
        mean = self._means[frame]
        if mean is None:
            return
        # Relative to the settings of that image, not to the present ones: otherwise the delay
        # would make the control loop oscillate.
        change = self._target / max(_mean_light(mean ** (1.0 / self._exponent)), 1e-6)
        change = float(np.clip(change, 1.0 / _MAX_CHANGE, _MAX_CHANGE))
        target = self._log_limited(float(np.exp(self._log_used[frame])) * change)
        self._log_target += self._step * (target - self._log_target)

    def _log_limited(self, response: float) -> float:
        limited = np.clip(response, _SHORTEST * self._full, _MAX_GAIN * self._full)
        return float(np.log(limited))


def _mean_light(mean: float) -> float:
    """Estimate of the mean light on the sensor, of full scale, from the mean of a clipped image.

    For light distributed evenly from 0 to twice its mean m, the mean of the image is m up to 1/2
    and 1 - 1 / (4 m) above.
    """
    return mean if mean <= 0.5 else min(_MAX_LIGHT, 0.25 / max(1.0 - mean, 1e-6))


_WANDER = 1.3
_PERIODS_S = (7.0, 11.0, 19.0)
_STEP = 1.8
_STEP_SPREAD = 0.2

_DARK = 0.12
_FIRST_DARK_S = (2.0, 4.0)
_DARK_LENGTH_S = (1.8, 2.2)
_DARK_EVERY_S = (7.0, 9.0)
_RAMP_S = 0.2

_SEED_WANDER, _SEED_STEPS, _SEED_DARK = 73, 74, 75


def drifting_light(times_s: Floats, strength: float, seed: int) -> Floats:
    """Light (F,) that drifts by up to 30 % at strength 1, with one or two sudden steps.

    It is 1 at time 0. A step, as of a lamp or at the edge of a shadow, is a factor of about 1.8 at
    strength 1, up or down; a second step has the opposite direction.
    """
    rng = np.random.default_rng([seed, _SEED_WANDER])
    weights = rng.uniform(0.5, 1.0, len(_PERIODS_S)) * rng.choice([-1.0, 1.0], len(_PERIODS_S))
    weights /= np.abs(weights).sum()
    periods = np.array(_PERIODS_S) * rng.uniform(0.8, 1.2, len(_PERIODS_S))
    drift = np.sin(2.0 * np.pi * times_s[:, None] / periods) @ weights
    # As powers, so that light stays positive and twice the strength applies each factor twice.
    return np.asarray(_WANDER ** (strength * drift) * _STEP ** (strength * _steps(times_s, seed)))


def dark_intervals(times_s: Floats, strength: float, seed: int) -> Floats:
    """Factor (F,) of the light: 0.12 at strength 1 for about 2 s in every 8 s.

    Transitions take 0.2 s. The first interval starts after 2 s to 4 s.
    """
    rng = np.random.default_rng([seed, _SEED_DARK])
    depth = np.zeros(len(times_s))
    start = rng.uniform(*_FIRST_DARK_S)
    while start < times_s[-1]:
        end = start + rng.uniform(*_DARK_LENGTH_S)
        inside = np.minimum(times_s - start, end - times_s) / _RAMP_S
        depth = np.maximum(depth, _smooth(inside))
        start += rng.uniform(*_DARK_EVERY_S)
    return np.asarray(1.0 - (1.0 - _DARK**strength) * depth)


def _steps(times_s: Floats, seed: int) -> Floats:
    """Exponent (F,) of the factor of the steps: 0 before the first step."""
    rng = np.random.default_rng([seed, _SEED_STEPS])
    count = int(rng.integers(1, 3))
    sign = float(rng.choice([-1.0, 1.0]))
    seconds = float(times_s[-1])
    exponent = np.zeros(len(times_s))
    for i in range(count):
        # One step in each part of the recording, away from its ends.
        at = seconds * (i + rng.uniform(0.3, 0.8)) / count
        size = rng.uniform(1.0 - _STEP_SPREAD, 1.0 + _STEP_SPREAD)
        exponent[times_s >= at] += sign * (-1.0) ** i * size
    return exponent


def _smooth(x: Floats) -> Floats:
    """Smooth step: 3 x² - 2 x³ for x from 0 to 1."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))
