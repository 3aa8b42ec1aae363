"""Pictures of features, and plots of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from vo.base.errors import OutputError
from vo.base.files.complete_file import writing
from vo.base.printable import printable
from vo.base.types import Bytes, Floats, Keypoints
from vo.tools.drawing import check_plot, saved_figure, write_picture
from vo.tools.laboratory.comparison import Comparison
from vo.tools.laboratory.repeatability import ACCURACIES_PX, PlaneScore

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SUBPIXEL_BITS = 4
_BY_OCTAVE = ((86, 180, 233), (230, 159, 0), (0, 158, 115), (204, 121, 167), (213, 94, 0))
"""Colours of octaves, RGB, of Okabe and Ito's palette, safe for colour-blind readers."""

_BAR, _MAPPED = "#0072B2", "viridis"


def draw_features(image: Bytes, found: Keypoints, sizes: Floats) -> Bytes:
    """The image (H, W, 3) BGR with features as circles of their size, and their orientation.

    `image`: (H, W) uint8. `sizes`: (N,) diameters in pixels.
    """
    picture = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    scale = 2**_SUBPIXEL_BITS
    for row in range(len(found) - 1, -1, -1):  # the strongest last, on top
        red, green, blue = _BY_OCTAVE[int(found.octave[row]) % len(_BY_OCTAVE)]
        colour = blue, green, red
        centre = found.xy[row].astype(np.float64)
        radius, angle = sizes[row] / 2.0, float(found.angle[row])
        at = tuple(np.rint(centre * scale).astype(int).tolist())
        length = round(radius * scale)
        cv2.circle(picture, at, length, colour, 1, cv2.LINE_AA, _SUBPIXEL_BITS)
        if np.isfinite(angle):
            tip = centre + radius * np.array([np.cos(angle), np.sin(angle)])
            end = tuple(np.rint(tip * scale).astype(int).tolist())
            cv2.line(picture, at, end, colour, 1, cv2.LINE_AA, _SUBPIXEL_BITS)
    return picture


def save_features(path: Path, image: Bytes, found: Keypoints, sizes: Floats) -> None:
    """Write the picture of `draw_features` as a PNG file.

    Raises:
        OutputError: the file cannot be written.
    """
    write_picture(path, draw_features(image, found, sizes))


def check_picture(path: Path) -> None:
    """Check that a picture of features can be written to a file of this name.

    Raises:
        OutputError: unsupported suffix.
    """
    if path.suffix.lower() != ".png":
        raise OutputError(f"{path}: pictures of features are PNG files; choose a name with .png")


def save_comparison(path: Path, rows: Sequence[Comparison], title: str) -> None:
    """Plot the share of good pairs by method and gap, and CPU times.

    `path`: .png, .pdf or .svg file. `rows`: of at least one method.

    Raises:
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    methods = list(dict.fromkeys(row.method for row in rows))
    with _comparison_figure(path, title, len(methods)) as (left, right):
        _draw_ratios(left, rows, methods)
        _draw_times(right, rows, methods)


@contextmanager
def _comparison_figure(path: Path, title: str, methods: int) -> Iterator[tuple[Axes, Axes]]:
    check_plot(path)
    with saved_figure(path, 9.0, 1.6 + 0.26 * methods, dpi=120) as figure:
        figure.suptitle(printable(title), fontsize=11, parse_math=False)
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.0, 1.2))
        yield left, right
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)


def save_planes(path: Path, scores: Sequence[PlaneScore], title: str) -> None:
    """Plot the ratio of homographies within 1, 3 and 5 px, and CPU times, by method.

    `path`: .png, .pdf or .svg file.

    Raises:
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    methods = [score.method for score in scores]
    ratios = np.array([[s.within_1_px, s.within_3_px, s.within_5_px] for s in scores])
    with _comparison_figure(path, title, len(methods)) as (left, right):
        _draw_table(left, ratios, methods, [f"{limit:g}" for limit in ACCURACIES_PX])
        left.set_xlabel("largest mean error of the corners, px")
        left.set_title("ratio of homographies", fontsize=9)
        _draw_bars(right, [2.0 * score.extract_ms + score.match_ms for score in scores])


def _draw_ratios(axes: Axes, rows: Sequence[Comparison], methods: Sequence[str]) -> None:
    gaps = sorted({row.gap for row in rows})
    ratios = np.full((len(methods), len(gaps)), np.nan)
    for row in rows:
        ratios[methods.index(row.method), gaps.index(row.gap)] = row.good_ratio
    _draw_table(axes, ratios, methods, [str(gap) for gap in gaps])
    axes.set_xlabel("frames between the images")
    axes.set_title("ratio of pairs with errors below 2°", fontsize=9)


def _draw_table(axes: Axes, ratios: Floats, methods: Sequence[str], columns: Sequence[str]) -> None:
    axes.imshow(ratios, vmin=0.0, vmax=1.0, cmap=_MAPPED, aspect="auto")
    for (row_number, column), value in np.ndenumerate(ratios):
        if np.isfinite(value):
            colour = "white" if value < 0.6 else "black"
            axes.text(
                column, row_number, f"{value:.2f}", ha="center", va="center", c=colour, fontsize=8
            )
    axes.set_xticks(range(len(columns)), list(columns))
    axes.set_yticks(range(len(methods)), list(methods), fontsize=8)


def _draw_times(axes: Axes, rows: Sequence[Comparison], methods: Sequence[str]) -> None:
    """Mean time of a pair: both images extracted, and matching."""
    total = dict.fromkeys(methods, 0.0)
    pairs = dict.fromkeys(methods, 0)
    for row in rows:
        total[row.method] += row.pairs * (2.0 * row.extract_ms + row.match_ms)
        pairs[row.method] += row.pairs
    _draw_bars(axes, [total[name] / pairs[name] for name in methods])


def _draw_bars(axes: Axes, ms: Sequence[float]) -> None:
    axes.barh(np.arange(len(ms)), ms, color=_BAR)
    axes.set_xscale("log")
    axes.set_xlabel("ms of CPU time per pair, one thread")
    axes.grid(axis="x", alpha=0.3)
