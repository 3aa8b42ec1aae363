"""Boards of markers: grids and ChArUco boards, whose pose uses all their corners."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from vo.base.errors import ConfigError
from vo.base.types import Bytes, Camera, Floats
from vo.engine.markers.dictionaries import marker_count
from vo.engine.markers.marker_problem import square_points
from vo.tools.calibrating.board import Board, make_board
from vo.tools.calibrating.detection import detect
from vo.tools.markers.image_markers import DetectedMarker, PlanePose
from vo.tools.markers.plane_pose import plane_pose

_CHESS_SIGMA_PX = 0.05
MAX_LENGTH_M = 5.0


class MarkerBoard(Protocol):
    """A flat board; its frame has x to the right, y up, z out of it, the origin in its middle."""

    def pose(
        self, camera: Camera, image: Bytes, markers: Sequence[DetectedMarker]
    ) -> PlanePose | None:
        """Its pose in an image (H, W) with these markers, None if too little of it is visible."""


class GridBoard(NamedTuple):
    """Markers 0, 1, 2, ... in rows from the top left, with gaps between them."""

    columns: int
    rows: int
    length_m: float
    gap_m: float

    def corners(self, number: int) -> Floats:
        """(4, 3) corners of a marker of the board."""
        row, column = divmod(number, self.columns)
        step = self.length_m + self.gap_m
        centre = (
            (column - 0.5 * (self.columns - 1)) * step,
            (0.5 * (self.rows - 1) - row) * step,
            0.0,
        )
        return square_points(self.length_m) + centre

    def pose(
        self, camera: Camera, image: Bytes, markers: Sequence[DetectedMarker]
    ) -> PlanePose | None:
        """See `MarkerBoard`."""
        seen = [marker for marker in markers if marker.id < self.columns * self.rows]
        if not seen:
            return None
        points = np.concatenate([self.corners(marker.id) for marker in seen])
        pixels = np.concatenate([marker.corners for marker in seen])
        sigma = float(np.sqrt(np.mean([marker.sigma_px**2 for marker in seen])))
        return plane_pose(camera, points, pixels, sigma)


class CharucoBoard(NamedTuple):
    """A ChArUco board of `vo calibrate`, located by its chessboard corners."""

    board: Board

    def pose(
        self, camera: Camera, image: Bytes, markers: Sequence[DetectedMarker]
    ) -> PlanePose | None:
        """See `MarkerBoard`."""
        found = detect(self.board, image)
        if found is None:
            return None
        size = self.board.square_m * np.array([self.board.columns + 1, self.board.rows + 1])
        points = self.board.points[found.ids]
        points = np.column_stack(
            [points[:, 0] - 0.5 * size[0], 0.5 * size[1] - points[:, 1], np.zeros(len(points))]
        )
        return plane_pose(camera, points, found.xy, _CHESS_SIGMA_PX)


def make_grid(columns: int, rows: int, length_m: float, gap_m: float, name: str) -> GridBoard:
    """A grid after checking its dimensions.

    Raises:
        ConfigError: there is no such board.
    """
    check_length(length_m)
    if min(columns, rows) < 1 or columns * rows < 2:
        raise ConfigError(f"a grid of {columns} x {rows} markers is no board; give two or more")
    if not 0.0 < gap_m <= MAX_LENGTH_M:
        raise ConfigError(
            f"`gap_m` is {gap_m:g} m; give the white space between markers in metres, such as 0.01"
        )
    if columns * rows > marker_count(name):
        raise ConfigError(
            f"the grid needs {columns * rows} markers, and {name} has {marker_count(name)}; choose "
            "a larger `dictionary`"
        )
    return GridBoard(columns, rows, length_m, gap_m)


def make_charuco(columns: int, rows: int, square_m: float, marker_m: float, name: str) -> Board:
    """A ChArUco board of `columns` x `rows` inner corners; `ConfigError` if there is none."""
    return make_board("charuco", columns, rows, square_m, marker_m, name)


def check_length(length_m: float) -> None:
    """Check the side of a marker.

    Raises:
        ConfigError: it is not a plausible number of metres.
    """
    if 0.001 <= length_m <= MAX_LENGTH_M:
        return
    hint = "the side of the black square in metres, 0.16 for 160 mm"
    if MAX_LENGTH_M < length_m <= 1000.0 * MAX_LENGTH_M:
        hint = f"metres, not millimetres: {length_m / 1000.0:g}"
    raise ConfigError(f"a marker of {length_m:g} m is implausible; `length_m` is in {hint}")
