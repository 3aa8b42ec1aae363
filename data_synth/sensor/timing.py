"""When each frame is taken, how its time is recorded, and how much light there is by then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.recipe import Effects
from data_synth.sensor import light
from vo.types import Bools, Floats, Ints

_JITTER_NS = 0.5e6
_OWN_JITTER = 0.3  # of the deviation, what a camera of a pair does not share with the other
_MOST_JITTER = 0.45  # of the time between frames, so that no frame overtakes another
_DROPPED = 0.01
_SEED_DROPS, _SEED_JITTER = 71, 72


@dataclass(frozen=True, eq=False)
class Timing:
    """The F frames of a recording.

    Attributes:
        times_s: (F,) true middle of each exposure, seconds from the start.
        stamps_ns: for each camera, (F,) the same moments as recorded, strictly increasing.
        dropped: for each camera, (F,) bool: frames that were never written.
        illumination: (F,) light on the sensor, 1 as at the start; 0 for black frames.
    """

    times_s: Floats
    stamps_ns: tuple[Ints, ...]
    dropped: tuple[Bools, ...]
    illumination: Floats

    @property
    def black(self) -> Bools:
        """Which frames (F,) see no light at all."""
        return np.asarray(self.illumination == 0.0)


def make_timing(
    effects: Effects, *, frames: int, fps: float, cameras: int, seed: int, first_stamp_ns: int
) -> Timing:
    """Draw the times, stamps, losses and light of a recording.

    Each effect has random numbers of its own: to change one leaves the others as they are.

    Args:
        effects: their strengths.
        frames: how many, F.
        fps: frames per second.
        cameras: how many, of one trigger.
        seed: of the random choices.
        first_stamp_ns: stamp of the start.
    """
    times_s = np.arange(frames) / fps
    illumination = light.wandering(times_s, effects.exposure, seed)
    illumination *= light.dark_stretches(times_s, effects.dark, seed)
    illumination[_blackout(frames, effects.blackout)] = 0.0
    return Timing(
        times_s=times_s,
        stamps_ns=_stamps(times_s, effects.jitter, fps, cameras, seed, first_stamp_ns),
        dropped=_drops(frames, effects.drops, cameras, seed),
        illumination=illumination,
    )


def _stamps(
    times_s: Floats, strength: float, fps: float, cameras: int, seed: int, first_stamp_ns: int
) -> tuple[Ints, ...]:
    """Late or early by what the trigger shares, and by a little of each camera's own."""
    rng = np.random.default_rng([seed, _SEED_JITTER])
    normals = rng.standard_normal((1 + cameras, len(times_s)))
    main = np.sqrt(1.0 - _OWN_JITTER**2) * normals[0]
    most = _MOST_JITTER * 1e9 / fps
    stamps = []
    for own in normals[1:]:
        late_ns = np.clip(strength * _JITTER_NS * (main + _OWN_JITTER * own), -most, most)
        stamps.append(first_stamp_ns + np.round(times_s * 1e9 + late_ns).astype(np.int64))
    return tuple(stamps)


def _drops(frames: int, strength: float, cameras: int, seed: int) -> tuple[Bools, ...]:
    """Half of a camera's losses strike all cameras at once, half only itself."""
    share = _DROPPED * strength
    draws = np.random.default_rng([seed, _SEED_DROPS]).uniform(size=(1 + cameras, frames))
    common = draws[0] < share / 2.0
    alone = share / (2.0 - share)  # so that both kinds together make the share
    dropped = tuple(common | (own < alone) for own in draws[1:])
    for camera in dropped:
        camera[0] = False
    return dropped


def _blackout(frames: int, count: int) -> slice:
    """`count` frames about the middle, but never the first."""
    first = max(1, (frames - count) // 2)
    return slice(first, first + count)
