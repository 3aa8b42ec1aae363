"""`vo synth`: synthetic recordings with exact ground truth."""

from __future__ import annotations

from dataclasses import dataclass
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
_RECIPE_FIELDS = ("world", "motion", "camera", "mono", "seconds", "fps", "seed")

Output = Annotated[
    Path | None,
    typer.Argument(
        metavar="OUTPUT", help="Folder to create, or a file for MCAP.", show_default=False
    ),
]
List = Annotated[bool, typer.Option("--list", help="List presets, cameras and settings, and exit.")]


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Scene, motion and cameras."""

    preset: Annotated[
        str | None,
        typer.Option(
            metavar="PRESET|FILE",
            help="Settings to start from: a preset (see --list) or a YAML file.",
            autocompletion=completion.recipes,
            rich_help_panel=_SCENE,
        ),
    ] = None
    world: Annotated[
        str | None,
        typer.Option(
            metavar="WORLD",
            help="room, corridor, street, warehouse or terrain.",
            rich_help_panel=_SCENE,
        ),
    ] = None
    motion: Annotated[
        str | None,
        typer.Option(
            metavar="MOTION",
            help="car, robot, handheld, drone, rotate, stop_and_go or loop.",
            rich_help_panel=_SCENE,
        ),
    ] = None
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Name of a camera (see --list), or a calibration file.",
            autocompletion=completion.cameras,
            rich_help_panel=_CAMERA,
        ),
    ] = None
    mono: Annotated[
        bool | None,
        typer.Option("--mono/--stereo", help="One camera, or two.", rich_help_panel=_CAMERA),
    ] = None
    effects: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=STRENGTH,…",
            help="Image effects: 0 for none, 1 for the usual strength. `none`, alone or first in "
            "the list, turns all others off.",
            rich_help_panel=_CAMERA,
        ),
    ] = None
    seconds: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Duration.", rich_help_panel=_SCENE),
    ] = None
    fps: Annotated[
        float | None,
        typer.Option(metavar="RATE", help="Frames per second.", rich_help_panel=_CAMERA),
    ] = None
    seed: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Random seed; equal seeds give equal files.", rich_help_panel=_SCENE
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class Files:
    """What is written."""

    to: Annotated[
        str | None,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help="Format to write: euroc, kitti, tum, folder, mcap (Foxglove) or mcap-ros2.",
            autocompletion=completion.output_formats,
            rich_help_panel=options.OUTPUT,
        ),
    ] = None
    codec: Annotated[
        str | None,
        typer.Option(
            metavar="CODEC",
            help="Image codec: png, jpeg (lossy), or raw in MCAP.",
            autocompletion=completion.codecs,
            rich_help_panel=options.OUTPUT,
        ),
    ] = None
    depth: Annotated[
        bool | None,
        typer.Option(
            "--depth/--no-depth",
            help="Write true depth images too.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override any setting (see --list); repeatable.",
            rich_help_panel=_SCENE,
        ),
    ] = None
    force: Annotated[
        bool,
        typer.Option("--force", help="Replace existing files.", rich_help_panel=options.OUTPUT),
    ] = False


def synth_command(
    *,
    output: Output = None,
    scene: Scene,
    files: Files,
    list_: List = False,
    printing: options.Printing,
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
    if list_:
        _list_choices(printing.json_output)
        return
    if output is None:
        raise typer.BadParameter("give the folder or file to create", param_hint="OUTPUT")
    from data_synth.recipe import load_recipe
    from vo.outputs.results.output_paths import refuse_to_overwrite

    named = {name: getattr(scene, name) for name in _RECIPE_FIELDS}
    named |= {"format": files.to, "codec": files.codec, "depth": files.depth}
    given = [f"{key}={value}" for key, value in named.items() if value is not None]
    overrides = [*(files.overrides or ()), *given, *_effect_settings(scene.effects)]
    recipe = load_recipe(scene.preset, overrides)
    refuse_to_overwrite([Path(each) for each in (scene.preset, scene.camera) if each], [output])
    with printing.warnings():
        made = _render(recipe, output, files.force, printing.errors)
    facts = _facts(made, output, recipe)
    text = (
        f"{output}: {counted(facts['frames'], facts['mode'] + ' frame')}, "
        f"{facts['seconds']:g} s, {facts['path_m']:.1f} m of path, {facts['format']}"
    )
    printing.show(lambda: facts, lambda: echo(text))


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
    from data_synth.sequence import make_sequence
    from vo.cli.progress import frame_bar

    with frame_bar(console, f"building the {recipe.world}", "rendering") as (_, show):
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
