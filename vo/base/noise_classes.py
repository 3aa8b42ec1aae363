"""Noise of inertial sensors whose calibration has none, by class of sensor."""

from __future__ import annotations

from vo.base.types import ImuNoise

NOISE_CLASSES: dict[str, ImuNoise] = {
    "consumer": ImuNoise(3e-4, 3e-5, 4e-3, 1e-3),
    "industrial": ImuNoise(1.5e-4, 1.5e-5, 1.5e-3, 3e-4),
    "tactical": ImuNoise(4e-5, 2e-6, 5e-4, 5e-5),
}
"""Noise by class of sensor: those of phones and small cameras, of industrial modules such as
ADIS16470 or VN-100, and of tactical ones such as STIM300. Data sheets, rounded up; the random walks
include what temperature does in minutes."""
