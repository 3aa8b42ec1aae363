"""Plots of a calibration of cameras and of the noise of an inertial sensor."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vo.tools.calibrating.advice import coverage
from vo.tools.calibrating.calibrate import CalibrationResult
from vo.tools.calibrating.calibration_figures import camera_rms_px
from vo.tools.calibrating.imu_noise import ImuNoiseResult, SensorNoise
from vo.tools.drawing import check_plot, saved_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Okabe and Ito's palette, safe for colour-blind readers.
_INK, _CORNER, _ARROW = "#333333", "#0072B2", "#D55E00"
_ARROW_LENGTH = 0.03
"""Length of the arrow of a typical residual, relative to the image width."""

_MAX_ARROWS = 600
_MAX_TICKS = 9


def save_plot(path: Path | str, result: CalibrationResult) -> None:
    """Save the plot of a calibration as a .png, .pdf or .svg file, with one row per camera.

    Raises:
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    path = Path(path)
    check_plot(path, "picture")
    cameras = result.detected.cameras
    with saved_figure(path, 12.0, 4.6 * cameras) as figure:
        grid = figure.add_gridspec(cameras, 2, width_ratios=(1.1, 1.0))
        for camera in range(cameras):
            _draw_corners(figure.add_subplot(grid[camera, 0]), result, camera)
            _draw_errors(figure.add_subplot(grid[camera, 1]), result, camera)


def _draw_corners(axes: Axes, result: CalibrationResult, camera: int) -> None:
    width, height = result.size
    observations = result.observations_of(camera)
    xy = np.concatenate([observation.xy for observation, _ in observations])
    residuals = np.concatenate([residual for _, residual in observations])
    typical = float(np.median(np.linalg.norm(residuals, axis=1)))
    magnification = _round_down(_ARROW_LENGTH * width / max(typical, 1e-6))
    uncovered = ~coverage(result, camera)
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(uncovered, cmap="Greys", vmin=0.0, vmax=4.0, extent=extent, zorder=0)
    axes.plot(*xy.T, ".", color=_CORNER, ms=6.0, alpha=0.7, mew=0)
    some = slice(None, None, len(xy) // _MAX_ARROWS + 1)
    axes.quiver(
        *xy[some].T,
        *(magnification * residuals[some]).T,
        color=_ARROW,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.0016,
        alpha=0.7,
    )
    matrix = result.fit.adjustment.parameters.intrinsics[camera]
    axes.plot(matrix[2], matrix[3], "+", color=_INK, ms=12, mew=1.5)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    title = f"cam{camera}: {len(xy)} corners, errors x {magnification}; + principal point\n"
    title += "grey: no corners, hold the board there too" if uncovered.any() else "all covered"
    axes.set_title(title, loc="left", fontsize=10)
    axes.tick_params(labelsize=9)


def _draw_errors(axes: Axes, result: CalibrationResult, camera: int) -> None:
    fit = result.fit
    frames = [fit.frames[observation.view] for observation, _ in result.observations_of(camera)]
    errors = [
        float(np.sqrt(np.mean(np.sum(r**2, axis=1)))) for _, r in result.observations_of(camera)
    ]
    whole = camera_rms_px(result, camera)
    axes.bar(range(len(errors)), errors, color=_CORNER, width=0.8)
    axes.axhline(whole, color=_INK, lw=0.9, ls=":")
    step = len(frames) // _MAX_TICKS + 1
    axes.set_xticks(range(0, len(frames), step), [str(frame) for frame in frames[::step]])
    axes.set_xlabel("frame")
    axes.set_ylabel("error (px, RMS)")
    title = (
        f"{fit.lenses[camera].distortion_model}: {whole:.3f} px RMS (dotted), {len(frames)} views"
    )
    axes.set_title(title, loc="left", fontsize=10)
    axes.grid(True, axis="y", color="#E6E6E6", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def _round_down(factor: float) -> int:
    """The factor rounded down to 1, 2 or 5 times a power of ten; at least 1."""
    power = 10.0 ** np.floor(np.log10(max(factor, 1.0)))
    return int(max(n for n in (1.0, 2.0, 5.0) if n * power <= max(factor, 1.0)) * power)


# Okabe and Ito's palette, safe for colour-blind readers.
_AXES = (("x", "#0072B2"), ("y", "#009E73"), ("z", "#D55E00"))
_INK = "#333333"


def save_allan_plot(path: Path, result: ImuNoiseResult) -> None:
    """Save the deviations of both sensors, with the fitted terms, as a .png, .pdf or .svg file.

    Raises:
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    check_plot(path, "picture")
    with saved_figure(path, 12.0, 4.8) as figure:
        left, right = figure.subplots(1, 2)
        _draw(left, result.gyro, "gyroscope", "rad/s")
        _draw(right, result.accel, "accelerometer", "m/s²")


def _draw(axes: Axes, sensor: SensorNoise, name: str, unit: str) -> None:
    curve, terms = sensor.curve, sensor.terms
    for (label, colour), deviation in zip(_AXES, curve.deviation.T, strict=True):
        axes.loglog(curve.tau_s, deviation, ".", color=colour, ms=5, label=label)
    axes.loglog(curve.tau_s, terms.deviation(curve.tau_s), color=_INK, lw=1.2, label="fit")
    axes.loglog(curve.tau_s, terms.density / curve.tau_s**0.5, "--", color=_INK, lw=0.8)
    if sensor.shows_walk:
        axes.loglog(curve.tau_s, terms.walk * (curve.tau_s / 3.0) ** 0.5, ":", color=_INK, lw=0.8)
    low, high = curve.deviation.min(), curve.deviation.max()
    axes.set_ylim(0.5 * low, 2.0 * high)
    axes.set_xlabel("averaging time, s")
    axes.set_ylabel(f"Allan deviation, {unit}")
    walk = f", walk {terms.walk:.3g} {unit}/s/√Hz (dotted)" if sensor.shows_walk else ""
    title = f"{name}: density {terms.density:.3g} {unit}/√Hz (dashed){walk}"
    axes.set_title(title, loc="left", fontsize=10)
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(fontsize=9)
