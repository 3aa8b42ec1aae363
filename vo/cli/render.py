"""`vo render`: a model in the images of a recording, drawn with the poses of a run."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

import typer

from vo.cli import options
from vo.cli.blocks import argument, option
from vo.cli.echo import echo

_PLACE = "Place of the model"


class Up(StrEnum):
    """Choices of `--up`."""

    Y = "y"
    Z = "z"
    MINUS_Y = "-y"


def render_command(
    run: Path = argument("Folder of a run.", metavar="RUN"),
    *,
    model: Path | None = argument(
        "Mesh as .ply or .obj.",
        default=None,
        metavar="MODEL",
        show_default="axes x (red), y (green), z (blue)",
    ),
    output: Path = option(
        "Video (.mp4) of all frames with a pose, or picture (.png, .jpg) of one.",
        "--output",
        "-o",
        default=Path("rendered.mp4"),
        metavar="FILE",
        panel=options.OUTPUT,
    ),
    at: str | None = option(
        "Position of the middle of its underside in the world of the run (y down).",
        default=None,
        metavar="X,Y,Z",
        panel=_PLACE,
    ),
    in_front: str | None = option(
        "In front of the camera at frame N, at this distance, and somewhat below its axis.",
        default=None,
        metavar="N:LENGTH",
        show_default="first frame, a quarter of the path's length",
        panel=_PLACE,
    ),
    on: str | None = option(
        "On a marker of the run (--markers), its underside in the plane of the marker.",
        default=None,
        metavar="MARKER:ID",
        panel=_PLACE,
    ),
    size: float | None = option(
        "Largest extent of the model.",
        default=None,
        metavar="LENGTH",
        show_default="a fifth of the distance, the side of a marker",
        panel=_PLACE,
    ),
    up: Up = option(
        "Axis of the model that points up: y, z or -y.", default=Up.Y, metavar="AXIS", panel=_PLACE
    ),
    frame: int | None = option(
        "Draw this frame alone.", default=None, min=0, metavar="N", panel=options.INPUT
    ),
    printing: options.Printing,
) -> None:
    """Place a model in a recording, and draw it with the poses of a run.

    Lengths are those of the run: metres, or map units of one camera. The
    recording must be where it was. Nothing in the images hides the model.

    Draw axes in front of the first camera:

      vo render out/ -o axes.mp4

    Put a statue 6 m in front of the camera at frame 40, 2 m high:

      vo render out/ statue.obj -o statue.mp4 --in-front 40:6 --size 2

    Let it stand on marker 3:

      vo run walk.mp4 -o out/ --markers 0.16
      vo render out/ statue.obj -o statue.mp4 --on marker:3
    """
    from vo.outputs.results.output_paths import refuse_to_overwrite
    from vo.tools.rendering.render import RenderOptions, render

    place = RenderOptions(
        None if at is None else _numbers(at),
        _frame_and_length(in_front),
        size,
        up.value,
        frame,
        None if on is None else _marker(on),
    )
    refuse_to_overwrite([model], [output])
    with printing.warnings():
        done = render(run, output, model, place)
    position = ", ".join(f"{value:.3f}" for value in done.at)
    text = (
        f"output      {done.output}\n"
        f"frames      {done.frames}, with the model in {done.with_model}\n"
        f"model at    {position} ({done.unit})"
    )
    record = {**done._asdict(), "output": str(done.output), "at": list(done.at)}
    printing.show(lambda: record, lambda: echo(text))


def _marker(text: str) -> int:
    kind, _, number = text.partition(":")
    if kind != "marker" or not number.isdigit():
        raise typer.BadParameter(f"'{text}' is no marker; give --on marker:ID, such as marker:3")
    return int(number)


def _numbers(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"'{text}' is no position; give --at X,Y,Z") from None
    return x, y, z


def _frame_and_length(text: str | None) -> tuple[int, float] | None:
    if text is None:
        return None
    number, _, length = text.partition(":")
    try:
        return int(number), float(length)
    except ValueError:
        raise typer.BadParameter(
            f"'{text}' is no frame and distance; give --in-front N:LENGTH, such as 40:6"
        ) from None
