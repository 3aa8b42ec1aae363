"""What became of the inertial sensor of a run, as it is reported."""

from __future__ import annotations

from vo.base.frozen import frozen


@frozen()
class InertialStates:
    """States of an inertial sensor at the newest keyframe, with standard deviations.

    Attributes:
        scale: metres of one unit of the visual map; 1 where that is the metre.
        scale_sigma: relative.
        up: (x, y, z) direction away from the earth in the world of the path.
        tilt_sigma_deg: of that direction, seen from the sensor.
        velocity_m_s: (x, y, z) in the world of the path.
        gyro_bias_rad_s: (x, y, z) in the frame of the sensor.
        accel_bias_m_s2: (x, y, z) in the frame of the sensor.
        misfit: root mean square of the normalised residuals; about 1 or less.
    """

    scale: float
    scale_sigma: float
    up: tuple[float, ...]
    tilt_sigma_deg: float
    velocity_m_s: tuple[float, ...]
    gyro_bias_rad_s: tuple[float, ...]
    gyro_bias_sigma_rad_s: tuple[float, ...]
    accel_bias_m_s2: tuple[float, ...]
    accel_bias_sigma_m_s2: tuple[float, ...]
    misfit: float


@frozen()
class InertialUse:
    """An inertial sensor of a recording.

    Attributes:
        reason: why nothing was estimated with it, None where something was.
        is_error: whether the reason is an error of the sensor.
        is_contradiction: whether it was found by the images of the run.
        first_frame: number of the frame from which on its states are known, None without.
        metric_worlds: numbers of the worlds of a single camera whose lengths are metres and whose
            z axis points up by it.
        states: the newest ones, None without.
        time_offset_s: what to add to stamps of images to get the sensor's clock, by the rotations
            of the run; None if these do not show it.
        time_offset_sigma_s: its standard deviation.
        given_time_offset_s: that of the recording or its calibration.
        stamp_sigma_s: standard deviation of the images' stamps from a regular rate, where samples
            agree with the images at regular times only; else 0.
    """

    sensor: str
    reason: str | None = None
    is_error: bool = False
    first_frame: int | None = None
    metric_worlds: tuple[int, ...] = ()
    states: InertialStates | None = None
    time_offset_s: float | None = None
    time_offset_sigma_s: float | None = None
    used_time_offset_s: float = 0.0
    given_time_offset_s: float = 0.0
    is_contradiction: bool = False
    stamp_sigma_s: float = 0.0
