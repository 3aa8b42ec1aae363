"""Sheets of markers in true size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vo.base.errors import ConfigError
from vo.base.types import Bytes
from vo.engine.markers.dictionaries import marker_count
from vo.tools.calibrating.printing import printed_page
from vo.tools.markers.boards import GridBoard, check_length
from vo.tools.markers.patterns import marker_cells, outer_cells, square_cells, square_colour

_PAGE_M = 0.190  # usable width of A4
_LEGEND_M = 0.008
_MAX_MARKERS = 100


def save_sheet(path: Path, name: str, ids: Sequence[int], length_m: float) -> None:
    """Write markers side by side, each with a white margin of one cell and its id and size.

    Raises:
        ConfigError: no such marker, or an implausible length.
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    check_length(length_m)
    _check_ids(name, ids)
    tile = length_m * len(marker_image(name, ids[0])) / square_cells(name)
    columns = max(1, min(len(ids), int(_PAGE_M / tile)))
    rows = -(-len(ids) // columns)
    width, height = columns * tile, rows * (tile + _LEGEND_M)
    with printed_page(path, width, height, "printed markers") as figure:
        for n, number in enumerate(ids):
            row, column = divmod(n, columns)
            left, top = column * tile, height - row * (tile + _LEGEND_M)
            axes = figure.add_axes(
                (left / width, (top - tile) / height, tile / width, tile / height)
            )
            axes.imshow(marker_image(name, number), cmap="gray", vmin=0, vmax=255)
            axes.set_axis_off()
            figure.text(
                (left + 0.5 * tile) / width,
                (top - tile - 0.4 * _LEGEND_M) / height,
                f"{name} {number}, {square_colour(name)} square {1000 * length_m:g} mm",
                ha="center",
                va="center",
                size=min(9.0, 1500.0 * tile / 25.4),
            )


def save_grid(path: Path, name: str, grid: GridBoard) -> None:
    """Write a grid of markers with its gaps; raises as `save_sheet` does."""
    step, length = grid.length_m + grid.gap_m, grid.length_m
    rim = outer_cells(name) * length / square_cells(name)
    margin = max(0.5 * length, grid.gap_m, _LEGEND_M) + rim
    if grid.gap_m < 2.0 * rim:
        raise ConfigError(
            f"`gap_m` is {grid.gap_m:g} m; markers of {name} also have cells around the square and "
            f"overlap; use {2.0 * rim:g} or more"
        )
    width = grid.columns * step - grid.gap_m + 2 * margin
    height = grid.rows * step - grid.gap_m + 2 * margin
    with printed_page(path, width, height, "printed markers") as figure:
        for number in range(grid.columns * grid.rows):
            row, column = divmod(number, grid.columns)
            left, bottom = margin + column * step, height - margin - row * step - length
            across = length + 2.0 * rim
            axes = figure.add_axes(
                ((left - rim) / width, (bottom - rim) / height, across / width, across / height)
            )
            axes.imshow(
                marker_cells(name, number), cmap="gray", vmin=0, vmax=255, interpolation="nearest"
            )
            axes.set_axis_off()
        legend = (
            f"vo markers --board grid --columns {grid.columns} --rows {grid.rows} "
            f"--length {length:g} --gap {grid.gap_m:g} --dictionary {name}"
        )
        size = min(9.0, 1.5 * 72 * width / 0.0254 / len(legend))
        figure.text(0.5, 0.4 * margin / height, legend, ha="center", va="center", size=size)


def marker_image(name: str, number: int) -> Bytes:
    """A marker with a white margin of one cell, one pixel for each cell."""
    return np.pad(marker_cells(name, number), 1, constant_values=255)


def parse_ids(text: str) -> list[int]:
    """Ids of a text such as `0-3,7`.

    Raises:
        ConfigError: it is not one.
    """
    ids: list[int] = []
    try:
        for part in text.split(","):
            first, dash, last = part.strip().partition("-")
            ids += range(int(first), int(last) + 1) if dash else [int(first)]
    except ValueError:
        ids = []
    if not ids or len(ids) > _MAX_MARKERS:
        raise ConfigError(
            f"`ids` is '{text}'; give up to {_MAX_MARKERS} numbers of markers, such as 0-3,7"
        )
    return ids


def _check_ids(name: str, ids: Sequence[int]) -> None:
    count = marker_count(name)
    for number in ids:
        if not 0 <= number < count:
            raise ConfigError(f"{name} has no marker {number}; its ids are 0 to {count - 1}")
