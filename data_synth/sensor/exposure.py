"""How long the shutter is open and how much is amplified: fixed, or by auto-exposure that lags."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.recipe import Effects

TARGET = 0.42  # mean of an image, of full scale, where grey levels are in line with light
_NORMAL_RADIANCE = 0.3  # mean of a scene that just needs the longest exposure
_LONGEST_S = 8e-3
_READOUT_S = 20e-3
_MOST_OF_FRAME = 0.9
_MOST_GAIN = 16.0
_SHORTEST = 1.0 / 400.0  # of the longest exposure
_LAG_S = 0.25
_MOST_CHANGE = 4.0  # that one image can ask for
_BRIGHTEST = 2.0  # mean light that a clipped image can tell, of full scale


@dataclass(frozen=True)
class Settings:
    """How one image is taken; the defaults turn radiance 0…1 into the full scale of grey.

    Attributes:
        exposure_s: time for which the shutter is open.
        gain: amplification of the signal, and of its noise.
        response: share of full scale (before the curve of grey levels) that radiance 1 gives in
            the light of the start: exposure by reference exposure, times gain.
    """

    exposure_s: float = 0.0
    gain: float = 1.0
    response: float = 1.0


def longest_exposure_s(effects: Effects, fps: float) -> float:
    """What a camera opens its shutter for at most, as it chooses to by the light."""
    return min(_LONGEST_S * effects.blur, _MOST_OF_FRAME / fps)


def readout_s(effects: Effects, fps: float) -> float:
    """Time from the exposure of the first row to that of the last."""
    return min(_READOUT_S * effects.rolling_shutter, _MOST_OF_FRAME / fps)


def grey_exponent(effects: Effects) -> float:
    """Exponent of the curve from light to grey levels, both 0…1; 1/2.2 at strength 1."""
    return 1.0 / (1.0 + 1.2 * effects.gamma)


def target_mean(effects: Effects) -> float:
    """What auto-exposure wants the mean of images to be, of full scale.

    With a curve it is brighter, though not by all that the curve adds: 0.53 for x^(1/2.2). At 0.42
    the bright half of the scale would stay empty, at the same light all would look pale.
    """
    return float(TARGET ** (0.5 + 0.5 * grey_exponent(effects)))


class AutoExposure:
    """Chooses each frame's settings by the means of the images before.

    Frame k is set when frame k - 1 is being exposed: by images up to k - 2, whether or not
    k - 1 has been observed yet, so that a caller may develop one frame behind. Settings follow
    with a time constant of 0.25 s at strength 1; at 0 they stay as the first light asks for.

    Both cameras of a pair share one, as they do in pairs that are made for stereo.
    """

    def __init__(self, effects: Effects, fps: float, radiance_mean: float) -> None:
        """Start settled.

        Args:
            effects: their strengths.
            fps: frames per second.
            radiance_mean: mean of the first view before exposure, dark corners included.
        """
        lag = _LAG_S * effects.exposure * fps
        self._step = 1.0 - float(np.exp(-1.0 / lag)) if lag > 0.0 else 0.0
        self._exponent = grey_exponent(effects)
        self._longest_s = longest_exposure_s(effects, fps)
        self._target = target_mean(effects) ** (1.0 / self._exponent)
        self._full = self._target / _NORMAL_RADIANCE  # response of the longest exposure at gain 1
        self._log_wanted = self._log_limited(self._target / max(radiance_mean, 1e-6))
        self._log_used: list[float] = []
        self._means: list[float | None] = []
        self._followed = 0

    def next(self) -> Settings:
        """Settings of the next frame.

        Raises:
            RuntimeError: the frame two before has not been observed.
        """
        frame = len(self._log_used)
        if len(self._means) < frame - 1:
            raise RuntimeError(f"frame {frame} needs the mean of frame {frame - 2}")
        while self._followed < frame - 1:
            self._follow(self._followed)
            self._followed += 1
        self._log_used.append(self._log_wanted)
        response = float(np.exp(self._log_wanted))
        share = response / self._full
        return Settings(min(1.0, share) * self._longest_s, max(1.0, share), response)

    def observe(self, image_mean: float | None) -> None:
        """Mean of the next image, 0…1 of full scale; None where there was no image."""
        self._means.append(image_mean)

    def _follow(self, frame: int) -> None:
        mean = self._means[frame]
        if mean is None:
            return
        # By what the image was taken with, not by what is wanted now: else the delay would make
        # the loop swing.
        change = self._target / max(_light(mean ** (1.0 / self._exponent)), 1e-6)
        change = float(np.clip(change, 1.0 / _MOST_CHANGE, _MOST_CHANGE))
        asked = self._log_limited(float(np.exp(self._log_used[frame])) * change)
        self._log_wanted += self._step * (asked - self._log_wanted)

    def _log_limited(self, response: float) -> float:
        limited = np.clip(response, _SHORTEST * self._full, _MOST_GAIN * self._full)
        return float(np.log(limited))


def _light(mean: float) -> float:
    """Mean light of a scene, of full scale, from the mean of its image, in which it is clipped.

    If light is spread evenly from 0 to twice its mean m, the image's mean is m up to 1/2 and
    1 - 1 / (4 m) above.
    """
    return mean if mean <= 0.5 else min(_BRIGHTEST, 0.25 / max(1.0 - mean, 1e-6))
