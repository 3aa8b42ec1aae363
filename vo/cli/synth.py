"""`vo synth`: makes a recording with exact ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from data_synth.recipe import Recipe

EPILOG = """\
Examples:

vo synth out/street --preset kitti

vo synth out/mine --camera my_calibration.yaml --world warehouse --motion robot --seconds 60

vo synth out/hard --preset euroc --effects blur=2,noise=3,dark=1 --seed 7

vo synth log.mcap --preset phone --format mcap-ros2 --codec jpeg

Then: vo run out/street -o out/run; vo eval out/run out/street
"""


def synth_command(
    output: Annotated[
        Path | None,
        typer.Argument(
            metavar="OUTPUT", help="Folder to make, or a file for MCAP.", show_default=False
        ),
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(
            metavar="PRESET|FILE",
            help="Where to start from: a preset (see --list) or a YAML file.",
        ),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(metavar="WORLD", help="room, corridor, street, warehouse or terrain."),
    ] = None,
    motion: Annotated[
        str | None,
        typer.Option(
            metavar="MOTION", help="car, robot, handheld, drone, rotate, stop_and_go or loop."
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Name of a camera (see --list), or a calibration file of your own.",
        ),
    ] = None,
    mono: Annotated[
        bool | None, typer.Option("--mono/--stereo", help="One camera, or both.")
    ] = None,
    effects: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=STRENGTH,…",
            help="What the camera suffers from: 0 is not at all, 1 is as usual. Or `none` for a "
            "perfect one, also as the first of the list.",
        ),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Length of the recording.")
    ] = None,
    fps: Annotated[float | None, typer.Option(metavar="RATE", help="Frames per second.")] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="The same seed gives the same bytes.")
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT", help="euroc, kitti, tum, folder, mcap (Foxglove) or mcap-ros2."
        ),
    ] = None,
    codec: Annotated[
        str | None,
        typer.Option(metavar="CODEC", help="Of the images: png, jpeg (loses), or raw in MCAP."),
    ] = None,
    depth: Annotated[
        bool | None, typer.Option("--depth/--no-depth", help="Write the true depth too.")
    ] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Any other setting, as --list shows them; may be given again.",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace what is there.")] = False,
    list_: Annotated[
        bool, typer.Option("--list", help="Show presets, cameras and settings, and stop.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Make a synthetic recording with exact ground truth.

    Films a world along a path with a camera of your choice: how good is the
    odometry for that camera and motion? The recording holds images,
    calibration, inertial measurements and the truth. It appears when it is
    whole.
    """
    from rich.console import Console

    console = Console(highlight=False, quiet=quiet)
    if list_:
        from vo.cli.synth_list import print_choices

        print_choices(console)
        return
    if output is None:
        raise typer.BadParameter("give the folder or file to make", param_hint="OUTPUT")
    from data_synth.recipe import load_recipe

    named = {
        "world": world,
        "motion": motion,
        "camera": camera,
        "mono": mono,
        "seconds": seconds,
        "fps": fps,
        "seed": seed,
        "format": format,
        "codec": codec,
        "depth": depth,
    }
    given = [f"{key}={value}" for key, value in named.items() if value is not None]
    recipe = load_recipe(preset, [*(overrides or ()), *given, *_effects(effects)])
    _make(recipe, output, force, console)


def _effects(text: str | None) -> list[str]:
    """`none,blur=2` as overrides."""
    from vo.errors import ConfigError

    parts = [part.strip() for part in (text or "").split(",") if part.strip()]
    settings = []
    for number, part in enumerate(parts):
        if part == "none" and number == 0:
            from data_synth.recipe import Effects

            settings += [f"effects.{name}=0" for name in Effects.model_fields]
        elif "=" in part:
            settings.append(f"effects.{part}")
        else:
            raise ConfigError(f"effect '{part}' is not of the form NAME=STRENGTH, as in blur=2")
    return settings


def _make(recipe: Recipe, output: Path, force: bool, console: Console) -> None:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as Remaining

    from data_synth.sequence import make_sequence

    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    still = console.quiet or not console.is_terminal
    with Progress(*columns, Remaining(), console=console, disable=still) as bar:
        task = bar.add_task(f"building the {recipe.world}", total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, description="rendering", completed=done, total=total)

        recording = make_sequence(output, recipe, force=force, on_frame=show)
    stereo = "stereo" if recording.rig.is_stereo else "mono"
    console.print(
        f"{output}: {len(recording)} {stereo} frames, {recipe.seconds:g} s, "
        f"{recording.path_m:.1f} m of path, {recipe.format}",
        soft_wrap=True,
    )
