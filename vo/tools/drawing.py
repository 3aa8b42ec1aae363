"""Pictures and plots as files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import cv2

from vo.base.errors import OutputError
from vo.base.extras import require
from vo.base.files.complete_file import writing
from vo.base.types import Bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
_PLOT_SUFFIXES = (".png", ".pdf", ".svg")


def check_picture(path: Path) -> None:
    """Check the name of a picture.

    Raises:
        OutputError: unsupported suffix.
    """
    if path.suffix.lower() not in _PICTURE_SUFFIXES:
        raise OutputError(f"{path} must end in {', '.join(_PICTURE_SUFFIXES)}, which are written")


def write_picture(path: Path, picture: Bytes, suffix: str = "") -> None:
    """Write a grey or BGR picture, in the format of its own or this suffix, and its folder.

    Raises:
        OutputError: the file cannot be written.
    """
    data = cv2.imencode(suffix or path.suffix.lower(), picture)[1].tobytes()
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def check_plot(path: Path, kind: str = "plot", what: str = "plots") -> None:
    """Check that a plot can be made, before the figures for it are computed.

    Raises:
        OutputError: unsupported suffix.
        MissingExtraError: matplotlib is not installed.
    """
    if path.suffix.lower() not in _PLOT_SUFFIXES:
        raise OutputError(f"{path}: unsupported kind of {kind}; use {', '.join(_PLOT_SUFFIXES)}")
    require("matplotlib", extra="report", what=what)


@contextmanager
def saved_figure(
    path: Path,
    width: float,
    height: float,
    *,
    dpi: int = 100,
    layout: Literal["constrained"] | None = "constrained",
) -> Iterator[Figure]:
    """A figure of this size in inches, without a window, written when the block ends.

    Raises:
        OutputError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=dpi, layout=layout)
    FigureCanvasAgg(figure)
    yield figure
    with writing(path):
        figure.savefig(path)
