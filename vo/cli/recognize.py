"""`vo recognize`: textured objects in images and recordings."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from vo.cli import completion, options
from vo.cli.blocks import Only, argument, block, option

_OBJECT = "Objects"


class RecognizeAction(StrEnum):
    """What to do."""

    ADD = "add"
    LEARN = "learn"
    LIST = "list"
    REMOVE = "remove"
    FIND = "find"


@block(_OBJECT)
class Request:
    """Arguments and options of the command."""

    action: RecognizeAction = argument(
        "add NAME IMAGE…: store an object; learn NAME RUN: store a solid one, from a run around "
        "it; list: what is stored; remove NAME: forget an "
        "object; find IMAGE… or find RECORDING: search for all objects.",
        metavar="ACTION",
    )
    words: list[str] = argument(
        "Name and images, name, or images, folders of images, or a recording.",
        default_factory=list,
        metavar="WORD",
    )
    database: Path = option(
        "Database of objects; the first add makes it.",
        "--database",
        "-d",
        default=Path("objects.vodb"),
        metavar="FILE",
    )
    width: float | None = option(
        "Width in metres of what the first image shows, for poses (add).", default=None, metavar="M"
    )
    radius: float | None = option(
        "Radius of the sphere that contains a solid object, in the unit of the run (learn).",
        default=None,
        metavar="LENGTH",
        show_default="as it fills the images",
    )
    detector: str | None = option(
        "What finds features, for a new database: sift, orb, akaze, aliked, … (add, learn).",
        default=None,
        metavar="NAME",
        show_default="sift",
        autocompletion=completion.detectors,
    )
    min_confidence: float = option(
        "Report objects from this probability on (find).",
        default=0.9,
        min=0.0,
        max=1.0,
        metavar="P",
    )
    reading: Annotated[options.Reading, Only("calibration", "format", "topic")]
    frames: options.Frames
    picture: Path | None = option(
        "Draw outlines and names to this .png or .jpg file (find): of a recording, the "
        "frame with most objects.",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )
    video: Path | None = option(
        "Draw the same into all frames of a recording, to this .mp4 file (find).",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )
    csv: Path | None = option(
        "Write a line for each object of each frame (find).",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )
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

      vo recognize find walk.mp4 --calibration camera.yaml --csv found.csv --video named.mp4

    Learn a solid object by walking around it, and find it elsewhere:

      vo run around_the_mug.mp4 -o mug_run --calibration camera.yaml
      vo recognize learn mug mug_run
      vo recognize find desk.jpg --calibration camera.yaml --picture found.png

    Search photos and folders of photos:

      vo recognize find desk.jpg photos/ --csv found.csv

    Exit status: 0 done, 1 nothing was found, or an error, 2 wrong usage.
    """
    from vo.cli.recognize_run import run_request

    if not run_request(request):
        raise typer.Exit(1)
