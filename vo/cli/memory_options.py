"""Options of `vo run` for the memory of places: loops, vocabulary and maps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from vo.cli import options

Loops = Annotated[
    bool | None,
    typer.Option(
        "--loops/--no-loops",
        help="Recognise places that were seen before, and correct the drift.",
        show_default="that of --config: on, except for live sources and features other than orb",
        rich_help_panel=options.ODOMETRY,
    ),
]
Vocabulary = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Vocabulary of place recognition, from `vo vocabulary train`.",
        show_default="the built-in one",
        rich_help_panel=options.ODOMETRY,
    ),
]
Map = Annotated[
    Path | None,
    typer.Option(
        "--map",
        metavar="FILE",
        help="Continue in a map from --save-map, whose places are recognised.",
        rich_help_panel=options.ODOMETRY,
    ),
]
Localize = Annotated[
    bool,
    typer.Option(
        "--localize",
        help="Only localise in --map, and add nothing to it.",
        rich_help_panel=options.ODOMETRY,
    ),
]
SaveMap = Annotated[
    Path | None,
    typer.Option(
        "--save-map",
        metavar="FILE",
        help="Also write the stored keyframes and their poses, for --map and vo map.",
        rich_help_panel=options.OUTPUT,
    ),
]
