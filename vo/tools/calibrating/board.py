"""The calibration board and the positions of its corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from vo.base.errors import ConfigError
from vo.base.types import Floats, Ints

Kind = Literal["chessboard", "charuco"]

_MAX_SQUARE_M = 1.0
_MARKER_RATIO = 0.75


@dataclass(frozen=True)
class Board:
    """A flat board of squares: x along the rows, y along the columns, z away from the viewer."""

    kind: Kind  # `chessboard`, or `charuco` with a marker in each white square
    columns: int  # inner corners in a row, where four squares meet
    rows: int
    square_m: float  # side of a square in metres
    marker_m: float = 0.0  # side of a marker in metres; 0 for a chessboard
    dictionary: str = "4X4_50"  # name of the marker dictionary, such as `4X4_50`
    # Marker layout of OpenCV before 4.6, which differs if the number of rows of squares is even
    legacy: bool = False

    @property
    def points(self) -> Floats:
        """(N, 3) inner corners in metres, row by row, from the outer corner of the board."""
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        flat = np.stack([column + 1.0, row + 1.0, np.zeros(len(row))], axis=1)
        return np.asarray(flat * self.square_m)

    @property
    def outline(self) -> Ints:
        """(4,) indices of the outermost inner corners, in circular order."""
        last = self.rows * self.columns - 1
        return np.array([0, self.columns - 1, last, last - self.columns + 1])

    def __str__(self) -> str:
        what = f"{self.kind} of {self.columns} x {self.rows} inner corners"
        return f"{what}, squares of {1000 * self.square_m:g} mm"

    def charuco(self) -> Any:
        """The same board as an object of OpenCV."""
        size = (self.columns + 1, self.rows + 1)
        markers = cv2.aruco.getPredefinedDictionary(dictionaries()[self.dictionary])
        board = cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, markers)
        board.setLegacyPattern(self.legacy)
        return board


def make_board(
    kind: Kind,
    columns: int,
    rows: int,
    square_m: float,
    marker_m: float | None = None,
    dictionary: str = "4X4_50",
    legacy: bool = False,
) -> Board:
    """Make a board after checking its dimensions.

    Raises:
        ConfigError: there is no such board.
    """
    if min(columns, rows) < 3:
        raise ConfigError(
            f"a board of {columns} x {rows} inner corners is too small; use at least 3 x 3 "
            "(`columns`, `rows`: corners where four squares meet)"
        )
    if not 0.0 < square_m <= _MAX_SQUARE_M:
        raise ConfigError(
            f"a square of {square_m:g} m is implausible; `square_m` is in metres, 0.03 for 30 mm"
        )
    if kind == "chessboard":
        return Board(kind, columns, rows, square_m)
    marker_m = _MARKER_RATIO * square_m if marker_m is None else marker_m
    if not 0.0 < marker_m < square_m:
        raise ConfigError(
            f"a marker of {marker_m:g} m does not fit into a square of {square_m:g} m; `marker_m` "
            "is in metres and smaller than `square_m`"
        )
    name = dictionary.upper().removeprefix("DICT_")
    known = dictionaries()
    if name not in known:
        raise ConfigError(f"unknown `dictionary` '{dictionary}'; use one of {', '.join(known)}")
    needed = (columns + 1) * (rows + 1) // 2
    available = len(cv2.aruco.getPredefinedDictionary(known[name]).bytesList)
    if needed > available:
        raise ConfigError(
            f"the board needs {needed} markers, but {name} has only {available}; choose a larger "
            "`dictionary`"
        )
    return Board(kind, columns, rows, square_m, marker_m, name, legacy)


def dictionaries() -> dict[str, int]:
    """OpenCV's marker dictionaries by name."""
    names = [name for name in dir(cv2.aruco) if name.startswith("DICT_") and name.isupper()]
    return {name.removeprefix("DICT_"): int(getattr(cv2.aruco, name)) for name in names}
