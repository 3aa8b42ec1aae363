"""`vo recognize`: textured objects in images and recordings."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from vo.cli import completion, options
from vo.cli.blocks import Only

_OBJECT = "Objects"


class RecognizeAction(StrEnum):
    """What to do."""

    ADD = "add"
    LIST = "list"
    REMOVE = "remove"
    FIND = "find"


@dataclass(frozen=True, kw_only=True)
class Request:
    """Arguments and options of the command."""

    action: Annotated[
        RecognizeAction,
        typer.Argument(
            metavar="ACTION",
            help="add NAME IMAGE…: store an object; list: what is stored; remove NAME: forget an "
            "object; find IMAGE or find RECORDING: search for all objects.",
        ),
    ]
    words: Annotated[
        list[str],
        typer.Argument(metavar="WORD", help="Name and images, name, or image or recording."),
    ] = field(default_factory=list)
    database: Annotated[
        Path,
        typer.Option(
            "--database",
            "-d",
            metavar="FILE",
            help="Database of objects; the first add makes it.",
            rich_help_panel=_OBJECT,
        ),
    ] = Path("objects.vodb")
    width: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Width in metres of what the first image shows, for poses (add).",
            rich_help_panel=_OBJECT,
        ),
    ] = None
    detector: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="What finds features, for a new database: sift, orb, akaze, aliked, … (add).",
            show_default="sift",
            autocompletion=completion.detectors,
            rich_help_panel=_OBJECT,
        ),
    ] = None
    min_confidence: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1.0,
            metavar="P",
            help="Report objects from this probability on (find).",
            rich_help_panel=_OBJECT,
        ),
    ] = 0.9
    reading: Annotated[options.Reading, Only("calibration", "format", "topic")]
    frames: options.Frames
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Draw outlines and names to this .png or .jpg file (find): of a recording, the "
            "frame with most objects.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None
    csv: Annotated[
        Path | None,
        typer.Option(
            "--csv",
            metavar="FILE",
            help="Write a line for each object of each frame (find).",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None
    printing: options.Printing


def recognize_command(
    request: Request,
) -> None:
    """Find known, textured objects in images and recordings.

    An object is added from one or more images that show nothing but the object. With the width of
    the object and the calibration of the camera, its pose is found too.

    Store two objects, 21 and 15 cm wide, and search an image for them:

      vo recognize add atlas front.png back.png --width 0.21
      vo recognize add tea tea.jpg --width 0.15
      vo recognize find desk.jpg --picture found.png

    Follow them through a recording, with their poses in every frame:

      vo recognize find walk.mp4 --calibration camera.yaml --csv found.csv

    Exit status: 0 done, 1 nothing was found, or an error, 2 wrong usage.
    """
    from vo.cli.recognize_run import run_request

    if not run_request(request):
        raise typer.Exit(1)
