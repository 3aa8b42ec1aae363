"""Plot of Allan deviations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.errors import OutputError
from vo.tools.calibrating.imu_noise import ImuNoiseResult, SensorNoise
from vo.tools.calibrating.plots import check_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's palette, safe for colour-blind readers.
_AXES = (("x", "#0072B2"), ("y", "#009E73"), ("z", "#D55E00"))
_INK = "#333333"


def save_allan_plot(path: Path, result: ImuNoiseResult) -> None:
    """Save the deviations of both sensors, with the fitted terms, as a .png, .pdf or .svg file.

    Raises:
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    check_suffix(path)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 4.8), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    _draw(left, result.gyro, "gyroscope", "rad/s")
    _draw(right, result.accel, "accelerometer", "m/s²")
    try:
        figure.savefig(path)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


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
