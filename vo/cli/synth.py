"""`vo synth`: synthetic recordings with exact ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vo.base.printable import counted
from vo.cli import completion, options
from vo.cli.echo import echo, echo_json

if TYPE_CHECKING:
    from rich.console import Console

    from data_synth.recipe import Recipe
    from data_synth.records import Recording

# Headings of the options in `--help`, besides those in `options`.
_SCENE, _CAMERA = "Scene and motion", "Camera"

Output = Annotated[
    Path | None,
    typer.Argument(
        metavar="OUTPUT", help="Folder to create, or a file for MCAP.", show_default=False
    ),
]
Preset = Annotated[
    str | None,
    typer.Option(
        metavar="PRESET|FILE",
        help="Settings to start from: a preset (see --list) or a YAML file.",
        autocompletion=completion.recipes,
        rich_help_panel=_SCENE,
    ),
]
World = Annotated[
    str | None,
    typer.Option(
        metavar="WORLD",
        help="room, corridor, street, warehouse or terrain.",
        rich_help_panel=_SCENE,
    ),
]
Motion = Annotated[
    str | None,
    typer.Option(
        metavar="MOTION",
        help="car, robot, handheld, drone, rotate, stop_and_go or loop.",
        rich_help_panel=_SCENE,
    ),
]
Camera = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        help="Name of a camera (see --list), or a calibration file.",
        autocompletion=completion.cameras,
        rich_help_panel=_CAMERA,
    ),
]
Mono = Annotated[
    bool | None,
    typer.Option("--mono/--stereo", help="One camera, or two.", rich_help_panel=_CAMERA),
]
EffectStrengths = Annotated[
    str | None,
    typer.Option(
        metavar="NAME=STRENGTH,…",
        help="Image effects: 0 for none, 1 for the usual strength. `none`, alone or first in the "
        "list, turns all others off.",
        rich_help_panel=_CAMERA,
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Duration.", rich_help_panel=_SCENE),
]
Fps = Annotated[
    float | None,
    typer.Option(metavar="RATE", help="Frames per second.", rich_help_panel=_CAMERA),
]
Seed = Annotated[
    int | None,
    typer.Option(
        metavar="N", help="Random seed; equal seeds give equal files.", rich_help_panel=_SCENE
    ),
]
Format = Annotated[
    str | None,
    typer.Option(
        "--to",
        metavar="FORMAT",
        help="Format to write: euroc, kitti, tum, folder, mcap (Foxglove) or mcap-ros2.",
        autocompletion=completion.output_formats,
        rich_help_panel=options.OUTPUT,
    ),
]
Codec = Annotated[
    str | None,
    typer.Option(
        metavar="CODEC",
        help="Image codec: png, jpeg (lossy), or raw in MCAP.",
        autocompletion=completion.codecs,
        rich_help_panel=options.OUTPUT,
    ),
]
Depth = Annotated[
    bool | None,
    typer.Option(
        "--depth/--no-depth", help="Write true depth images too.", rich_help_panel=options.OUTPUT
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override any setting (see --list); repeatable.",
        rich_help_panel=_SCENE,
    ),
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Replace existing files.", rich_help_panel=options.OUTPUT),
]
List = Annotated[bool, typer.Option("--list", help="List presets, cameras and settings, and exit.")]


def synth_command(
    output: Output = None,
    preset: Preset = None,
    world: World = None,
    motion: Motion = None,
    camera: Camera = None,
    mono: Mono = None,
    effects: EffectStrengths = None,
    seconds: Seconds = None,
    fps: Fps = None,
    seed: Seed = None,
    to: Format = None,
    codec: Codec = None,
    depth: Depth = None,
    overrides: Overrides = None,
    force: Force = False,
    list_: List = False,
    json_output: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Render a synthetic recording with exact ground truth.

    The recording contains images, calibration, inertial measurements and
    ground truth. The output appears when it is complete.

    Render a preset, run on it, and evaluate:

      vo synth out/street --preset kitti
      vo run out/street -o out/run
      vo eval out/run out/street

    Use your own camera:

      vo synth out/mine --camera calibration.yaml --world warehouse --motion robot --seconds 60

    Make it difficult, or write another format:

      vo synth out/hard --preset euroc --effects blur=2,noise=3,dark=1 --seed 7
      vo synth log.mcap --preset phone --to mcap-ros2 --codec jpeg
    """
    from vo.cli.console import standard_error

    if list_:
        _list_choices(json_output)
        return
    if output is None:
        raise typer.BadParameter("give the folder or file to create", param_hint="OUTPUT")
    from data_synth.recipe import load_recipe
    from vo.cli.progress import warnings_on
    from vo.outputs.results.output_paths import refuse_to_overwrite

    scene = {"world": world, "motion": motion, "camera": camera, "mono": mono}
    sampling = {"seconds": seconds, "fps": fps, "seed": seed}
    files = {"format": to, "codec": codec, "depth": depth}
    named = {**scene, **sampling, **files}
    given = [f"{key}={value}" for key, value in named.items() if value is not None]
    recipe = load_recipe(preset, [*(overrides or ()), *given, *_effect_settings(effects)])
    refuse_to_overwrite([Path(each) for each in (preset, camera) if each], [output])
    with warnings_on(standard_error(), quiet=quiet):
        made = _render(recipe, output, force, standard_error(quiet=quiet))
    facts = _facts(made, output, recipe)
    if json_output:
        echo_json(facts)
    elif not quiet:
        echo(
            f"{output}: {counted(facts['frames'], facts['mode'] + ' frame')}, "
            f"{facts['seconds']:g} s, {facts['path_m']:.1f} m of path, {facts['format']}"
        )


def _list_choices(as_json: bool) -> None:
    from vo.cli.console import standard_output
    from vo.cli.synth_list import choices, print_choices

    if as_json:
        echo_json(choices())
    else:
        print_choices(standard_output())


def _effect_settings(text: str | None) -> list[str]:
    """Settings of a list of effects, such as `none,blur=2`."""
    from vo.base.errors import ConfigError

    parts = [part.strip() for part in (text or "").split(",") if part.strip()]
    settings = []
    for number, part in enumerate(parts):
        if part == "none" and number == 0:
            from data_synth.recipe import Effects

            settings += [f"effects.{name}=0" for name in Effects.model_fields]
        elif "=" in part:
            settings.append(f"effects.{part}")
        else:
            raise ConfigError(f"invalid effect '{part}'; use NAME=STRENGTH, such as blur=2")
    return settings


def _render(recipe: Recipe, output: Path, force: bool, console: Console) -> Recording:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as Remaining

    from data_synth.sequence import make_sequence

    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    is_hidden = console.quiet or not console.is_terminal
    with Progress(*columns, Remaining(), console=console, disable=is_hidden) as bar:
        task = bar.add_task(f"building the {recipe.world}", total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, description="rendering", completed=done, total=total)

        return make_sequence(output, recipe, force=force, on_frame=show)


def _facts(recording: Recording, output: Path, recipe: Recipe) -> dict[str, Any]:
    return {
        "output": str(output),
        "format": recipe.format,
        "mode": "stereo" if recording.rig.is_stereo else "mono",
        "frames": len(recording),
        "seconds": recipe.seconds,
        "path_m": round(recording.path_m, 6),
    }
