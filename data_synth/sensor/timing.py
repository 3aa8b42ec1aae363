"""Times, recorded stamps, lost frames and light of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.recipe import Effects
from data_synth.sensor.exposure import dark_intervals, drifting_light
from vo.base.types import Bools, Floats, Ints

_JITTER_NS = 0.5e6
_OWN_JITTER = 0.3  # fraction of the deviation that the cameras of a pair do not share
_MAX_JITTER = 0.45  # of the time between frames, so that stamps stay in order
_DROPPED = 0.01
_STAGGER_S, _MAX_STAGGER = 0.04, 0.9  # at most this ratio of the time between frames
_SEED_DROPS, _SEED_JITTER = 71, 72


@dataclass(frozen=True, eq=False)
class Timing:
    """The F frames of a recording."""

    times_s: Floats  # (F,) true middle of each exposure, seconds from the start
    stamps_ns: tuple[Ints, ...]  # for each camera, (F,) recorded stamps, strictly increasing
    late_s: tuple[float, ...]  # for each camera, time of its images after those of the first
    dropped: tuple[Bools, ...]  # for each camera, (F,) bool: missing frames
    illumination: Floats  # (F,) light, `effects.light` at the start; 0 for black frames

    @property
    def black(self) -> Bools:
        """Black frames (F,)."""
        return np.asarray(self.illumination == 0.0)


def make_timing(
    effects: Effects, *, frames: int, fps: float, cameras: int, seed: int, first_stamp_ns: int
) -> Timing:
    """Draw times, stamps, lost frames and light of a recording.

    Each effect has its own random numbers, so that effects do not influence each other.

    `frames`: number of frames, F. `fps`: frames per second. `cameras`: number of cameras, with a
    common trigger unless `effects.stagger` is given.
    """
    times_s = np.arange(frames) / fps
    illumination = drifting_light(times_s, effects.exposure, seed)
    illumination *= effects.light * dark_intervals(times_s, effects.dark, seed)
    illumination[_blackout(frames, effects.blackout)] = 0.0
    late_s = tuple(
        min(effects.stagger * _STAGGER_S, _MAX_STAGGER / fps) * number / max(cameras - 1, 1)
        for number in range(cameras)
    )
    stamps = _stamps(times_s, effects.jitter, fps, cameras, seed, first_stamp_ns)
    return Timing(
        times_s=times_s,
        stamps_ns=tuple(own + round(1e9 * late) for own, late in zip(stamps, late_s, strict=True)),
        late_s=late_s,
        dropped=_drops(frames, effects.drops, cameras, seed),
        illumination=illumination,
    )


def _stamps(
    times_s: Floats, strength: float, fps: float, cameras: int, seed: int, first_stamp_ns: int
) -> tuple[Ints, ...]:
    """Stamps with jitter, partly common to all cameras and partly of each camera."""
    rng = np.random.default_rng([seed, _SEED_JITTER])
    normals = rng.standard_normal((1 + cameras, len(times_s)))
    common = np.sqrt(1.0 - _OWN_JITTER**2) * normals[0]
    max_ns = _MAX_JITTER * 1e9 / fps
    stamps = []
    for own in normals[1:]:
        late_ns = np.clip(strength * _JITTER_NS * (common + _OWN_JITTER * own), -max_ns, max_ns)
        stamps.append(first_stamp_ns + np.round(times_s * 1e9 + late_ns).astype(np.int64))
    return tuple(stamps)


def _drops(frames: int, strength: float, cameras: int, seed: int) -> tuple[Bools, ...]:
    """Lost frames: half of them common to all cameras, half of one camera only."""
    fraction = _DROPPED * strength
    draws = np.random.default_rng([seed, _SEED_DROPS]).uniform(size=(1 + cameras, frames))
    common = draws[0] < fraction / 2.0
    alone = fraction / (2.0 - fraction)  # so that both kinds together give the fraction
    dropped = tuple(common | (own < alone) for own in draws[1:])
    for camera in dropped:
        camera[0] = False
    return dropped


def _blackout(frames: int, count: int) -> slice:
    """`count` frames about the middle, but never the first."""
    first = max(1, (frames - count) // 2)
    return slice(first, first + count)
