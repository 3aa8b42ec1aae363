"""Options of `vo run` for the rerun viewer."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

_VISUALISATION = "Visualisation with rerun"


class ImageSize(StrEnum):
    """Choices of `--rrd-images`."""

    FULL = "full"
    HALF = "half"
    NONE = "none"


Rrd = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Record for the rerun viewer to this file, for `vo view`.",
        rich_help_panel=_VISUALISATION,
    ),
]
RrdImages = Annotated[
    ImageSize,
    typer.Option(help="Size of the images in the viewer.", rich_help_panel=_VISUALISATION),
]
Spawn = Annotated[
    bool,
    typer.Option(
        "--spawn", help="Open a rerun viewer and stream to it.", rich_help_panel=_VISUALISATION
    ),
]
Connect = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Stream to a running rerun viewer.",
        rich_help_panel=_VISUALISATION,
    ),
]
Serve = Annotated[
    bool,
    typer.Option(
        "--serve",
        help="Stream to a web page for a browser on this machine.",
        rich_help_panel=_VISUALISATION,
    ),
]
