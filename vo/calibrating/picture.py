"""One picture of a calibration: where corners were seen, how they miss, and each view's error."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vo.calibrating.advice import coverage
from vo.calibrating.calibrate import Result
from vo.calibrating.report import camera_rms_px
from vo.errors import OutputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart with every kind of colour vision.
_INK, _CORNER, _ARROW = "#333333", "#0072B2", "#D55E00"
_SUFFIXES = (".png", ".pdf", ".svg")
_ARROW_SHARE = 0.03
"""Length of an arrow for a typical residual, of the image's width."""

_MOST_ARROWS = 600
_MOST_TICKS = 9


def save_picture(path: Path | str, result: Result) -> None:
    """Draw a calibration into a .png, .pdf or .svg file.

    Raises:
        OutputError: another suffix, or the file cannot be written.
    """
    path = Path(path)
    check_suffix(path)
    figure = draw(result)
    try:
        figure.savefig(path)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


def check_suffix(path: Path) -> None:
    """Refuse what no picture can be written to.

    Raises:
        OutputError: another suffix.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise OutputError(f"{path}: a picture ends in {', '.join(_SUFFIXES)}")


def draw(result: Result) -> Figure:
    """The picture as a figure that belongs to no window: a row for each camera."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    cameras = result.survey.cameras
    figure = Figure(figsize=(12.0, 4.6 * cameras), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(cameras, 2, width_ratios=(1.1, 1.0))
    for camera in range(cameras):
        _draw_corners(figure.add_subplot(grid[camera, 0]), result, camera)
        _draw_errors(figure.add_subplot(grid[camera, 1]), result, camera)
    return figure


def _draw_corners(axes: Axes, result: Result, camera: int) -> None:
    width, height = result.size
    sights = result.sights_of(camera)
    xy = np.concatenate([sight.xy for sight, _ in sights])
    residuals = np.concatenate([residual for _, residual in sights])
    typical = float(np.median(np.linalg.norm(residuals, axis=1)))
    longer = _round(_ARROW_SHARE * width / max(typical, 1e-6))
    bare = ~coverage(result, camera)
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(bare, cmap="Greys", vmin=0.0, vmax=4.0, extent=extent, zorder=0)
    axes.plot(*xy.T, ".", color=_CORNER, ms=6.0, alpha=0.7, mew=0)
    some = slice(None, None, len(xy) // _MOST_ARROWS + 1)
    axes.quiver(
        *xy[some].T,
        *(longer * residuals[some]).T,
        color=_ARROW,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.0016,
        alpha=0.7,
    )
    matrix = result.fit.adjusted.unknowns.intrinsics[camera]
    axes.plot(matrix[2], matrix[3], "+", color=_INK, ms=12, mew=1.5)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    title = f"cam{camera}: {len(xy)} corners, their errors {longer} times as long; + optical axis\n"
    title += "grey: no corner yet, hold the board there too" if bare.any() else "seen everywhere"
    axes.set_title(title, loc="left", fontsize=10)
    axes.tick_params(labelsize=9)


def _draw_errors(axes: Axes, result: Result, camera: int) -> None:
    fit = result.fit
    frames = [fit.frames[sight.view] for sight, _ in result.sights_of(camera)]
    errors = [float(np.sqrt(np.mean(np.sum(r**2, axis=1)))) for _, r in result.sights_of(camera)]
    whole = camera_rms_px(result, camera)
    axes.bar(range(len(errors)), errors, color=_CORNER, width=0.8)
    axes.axhline(whole, color=_INK, lw=0.9, ls=":")
    every = len(frames) // _MOST_TICKS + 1
    axes.set_xticks(range(0, len(frames), every), [str(frame) for frame in frames[::every]])
    axes.set_xlabel("frame")
    axes.set_ylabel("error (px, RMS)")
    title = f"{fit.lenses[camera].model}: {whole:.3f} px RMS (dotted), {len(frames)} views"
    axes.set_title(title, loc="left", fontsize=10)
    axes.grid(True, axis="y", color="#E6E6E6", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def _round(factor: float) -> int:
    """A round number near to it: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(factor, 1.0)))
    return int(max(n for n in (1.0, 2.0, 5.0) if n * power <= max(factor, 1.0)) * power)
