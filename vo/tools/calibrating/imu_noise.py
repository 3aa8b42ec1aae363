"""Noise of an inertial sensor from a recording at rest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.files.complete_file import writing
from vo.base.types import Floats, ImuNoise, Ints
from vo.tools.calibrating.allan import AllanCurve, NoiseTerms, allan_curve, fit_terms

MIN_REST_S = 60.0
_BLOCK_S = 1.0
_MOVED = 3.0  # standard deviation of a block, relative to that of still ones, that is motion
_STILL_PERCENTILE = 20
_GAP = 2.5  # median intervals
_USUAL_WALK_SD = 0.3
_LOW_WALK = 0.02  # of the density, per √s: what a walk is taken for that is too small to be seen


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Noise of one of the two sensors: its curve and terms."""

    curve: AllanCurve
    terms: NoiseTerms

    @property
    def shows_walk(self) -> bool:
        """Whether the recording is long enough for the random walk."""
        return self.terms.walk_sd < _USUAL_WALK_SD

    @property
    def walk(self) -> float:
        """The random walk, or the largest that the recording does not show."""
        if self.shows_walk:
            return self.terms.walk
        # K √(τ/3) is less than the deviation at the longest time.
        last = float(self.curve.pooled[-1]) * float(np.sqrt(3.0 / self.curve.tau_s[-1]))
        return max(min(last, self.terms.density), _LOW_WALK * self.terms.density)


@dataclass(frozen=True, eq=False)
class ImuNoiseResult:
    """Noise of an inertial sensor."""

    gyro: SensorNoise  # of the gyroscope, in rad/s
    accel: SensorNoise  # of the accelerometer, in m/s²
    rate_hz: float  # samples per second
    start_s: float  # start of the part at rest, from the first sample
    rest_s: float
    recorded_s: float

    @property
    def noise(self) -> ImuNoise:
        """Densities and random walks."""
        return ImuNoise(
            self.gyro.terms.density,
            self.gyro.walk,
            self.accel.terms.density,
            self.accel.walk,
        )


def measure_noise(stamps_ns: Ints, gyro: Floats, accel: Floats) -> ImuNoiseResult:
    """Measure the noise in the longest part in which the sensor is at rest.

    `stamps_ns`: (N,) increasing. `gyro`: (N, 3) rad/s. `accel`: (N, 3) m/s².

    Raises:
        CalibrationError: there is no minute at rest, or a sensor gives constant values.
    """
    if len(stamps_ns) < 3:
        raise CalibrationError(f"{len(stamps_ns)} samples; record at least a minute at rest")
    interval_s = float(np.median(np.diff(stamps_ns))) / 1e9
    rows = _still_part(stamps_ns, gyro, accel, interval_s)
    rest_s = (rows.stop - rows.start) * interval_s
    for name, values in (("gyroscope", gyro[rows]), ("accelerometer", accel[rows])):
        if not (np.ptp(values, axis=0) > 0.0).all():
            raise CalibrationError(f"an axis of the {name} is constant: it has no noise to measure")
    if rest_s < MIN_REST_S:
        raise CalibrationError(
            f"the sensor is at rest without gaps for {rest_s:.0f} s at most; record at least "
            f"{MIN_REST_S:.0f} s on something that does not shake, better an hour"
        )
    curves = [allan_curve(values[rows], 1.0 / interval_s) for values in (gyro, accel)]
    first, second = (SensorNoise(curve, fit_terms(curve)) for curve in curves)
    return ImuNoiseResult(
        first,
        second,
        1.0 / interval_s,
        float(stamps_ns[rows.start] - stamps_ns[0]) / 1e9,
        rest_s,
        float(stamps_ns[-1] - stamps_ns[0]) / 1e9,
    )


def _still_part(stamps_ns: Ints, gyro: Floats, accel: Floats, interval_s: float) -> slice:
    """The longest run of samples without motion and gaps."""
    block = max(2, round(_BLOCK_S / interval_s))
    count = len(stamps_ns) // block
    if count < 2:
        return slice(0, len(stamps_ns))
    is_still = np.ones(count, dtype=bool)
    for values in (gyro, accel):
        blocks = values[: count * block].reshape(count, block, 3)
        spread = np.linalg.norm(blocks.std(axis=1), axis=1)
        is_still &= spread <= _MOVED * np.percentile(spread, _STILL_PERCENTILE)
    gaps = np.flatnonzero(np.diff(stamps_ns) > _GAP * interval_s * 1e9) // block
    is_still[gaps[gaps < count]] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_still.astype(int), [0]])))
    starts, ends = edges[::2], edges[1::2]
    if not len(starts):
        return slice(0, 0)
    longest = int(np.argmax(ends - starts))
    return slice(int(starts[longest]) * block, int(ends[longest]) * block)


def warnings_of(result: ImuNoiseResult) -> list[str]:
    """What the user should know about the result."""
    lines = []
    if result.rest_s < 0.95 * result.recorded_s:
        lines.append(
            f"the sensor moved, or samples are missing: only {result.rest_s:.0f} s from "
            f"{result.start_s:.0f} s on are used"
        )
    short = [
        name
        for name, sensor in (("gyroscope", result.gyro), ("accelerometer", result.accel))
        if not sensor.shows_walk
    ]
    if short:
        lines.append(
            f"{result.rest_s / 60.0:.0f} minutes do not show the random walk of the "
            f"{' and the '.join(short)}: the value is an upper limit; record for longer"
        )
    return lines


def write_kalibr(path: Path, result: ImuNoiseResult, topic: str) -> None:
    """Write Kalibr's `imu.yaml`.

    Raises:
        OutputError: the file cannot be written.
    """
    noise = result.noise
    lines = [
        f"# from {result.rest_s:.0f} s at rest: overlapping Allan deviation",
        f"accelerometer_noise_density: {noise.accel_noise:.6g}  # m/s^2/sqrt(Hz)",
        f"accelerometer_random_walk: {noise.accel_walk:.6g}  # m/s^3/sqrt(Hz)",
        f"gyroscope_noise_density: {noise.gyro_noise:.6g}  # rad/s/sqrt(Hz)",
        f"gyroscope_random_walk: {noise.gyro_walk:.6g}  # rad/s^2/sqrt(Hz)",
        f"rostopic: {topic}",
        f"update_rate: {result.rate_hz:.6g}  # Hz",
    ]
    with writing(path):
        path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
