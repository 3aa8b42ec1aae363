"""`vo synth`: synthetic recordings with exact ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vo.base.printable import counted
from vo.cli import completion, options
from vo.cli.blocks import argument, block, option
from vo.cli.echo import echo, echo_json

if TYPE_CHECKING:
    from rich.console import Console

    from data_synth.recipe import Recipe
    from data_synth.records import Recording

# Headings of the options in `--help`, besides those in `options`.
_SCENE, _CAMERA = "Scene and motion", "Camera"
_RECIPE_FIELDS = ("world", "motion", "camera", "mono", "seconds", "fps", "seed")


@block(_SCENE)
class Scene:
    """Scene, motion and cameras."""

    preset: str | None = option(
        "Settings to start from: a preset (see --list) or a YAML file.",
        default=None,
        metavar="PRESET|FILE",
        autocompletion=completion.recipes,
    )
    world: str | None = option(
        "room, corridor, white_corridor, street, warehouse or terrain.",
        default=None,
        metavar="WORLD",
    )
    motion: str | None = option(
        "car, robot, handheld, drone, rotate, stop_and_go or loop.", default=None, metavar="MOTION"
    )
    camera: str | None = option(
        "Name of a camera or rig (see --list), or a calibration file with any number of cameras.",
        "--camera",
        "--rig",
        default=None,
        metavar="NAME|FILE",
        autocompletion=completion.cameras,
        panel=_CAMERA,
    )
    mono: bool | None = option(
        "The first camera only, or all.", "--mono/--stereo", default=None, panel=_CAMERA
    )
    effects: str | None = option(
        "Image effects: 0 for none, 1 for the usual strength. `none`, alone or first in "
        "the list, turns all others off.",
        default=None,
        metavar="NAME=STRENGTH,…",
        panel=_CAMERA,
    )
    seconds: float | None = option("Duration.", default=None, metavar="SECONDS")
    fps: float | None = option("Frames per second.", default=None, metavar="RATE", panel=_CAMERA)
    seed: int | None = option(
        "Random seed; equal seeds give equal files.", default=None, metavar="N"
    )


@block(options.OUTPUT)
class Files:
    """What is written."""

    to: str | None = option(
        "Format to write: euroc, kitti, tum, folder, mcap (Foxglove) or mcap-ros2.",
        default=None,
        metavar="FORMAT",
        autocompletion=completion.output_formats,
    )
    codec: str | None = option(
        "Image codec: png, jpeg (lossy), or raw in MCAP.",
        default=None,
        metavar="CODEC",
        autocompletion=completion.codecs,
    )
    depth: bool | None = option("Write true depth images too.", "--depth/--no-depth", default=None)
    overrides: list[str] | None = option(
        "Override any setting (see --list); repeatable.",
        "--set",
        default=None,
        metavar="KEY=VALUE",
        panel=_SCENE,
    )
    force: bool = option("Replace existing files.", "--force", default=False)


def synth_command(
    *,
    output: Path | None = argument(
        "Folder to create, or a file for MCAP.", default=None, metavar="OUTPUT", show_default=False
    ),
    scene: Scene,
    files: Files,
    list_: bool = option("List presets, cameras and settings, and exit.", "--list", default=False),
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
    from data_synth.recipe import effect_settings, load_recipe
    from vo.outputs.results.output_paths import refuse_to_overwrite

    named = {name: getattr(scene, name) for name in _RECIPE_FIELDS}
    named |= {"format": files.to, "codec": files.codec, "depth": files.depth}
    given = [f"{key}={value}" for key, value in named.items() if value is not None]
    overrides = [*(files.overrides or ()), *given, *effect_settings(scene.effects or "")]
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


def _render(recipe: Recipe, output: Path, force: bool, console: Console) -> Recording:
    from data_synth.sequence import make_sequence
    from vo.cli.progress import frame_bar

    with frame_bar(console, f"building the {recipe.world}", "rendering") as (_, show):
        return make_sequence(output, recipe, force=force, on_frame=show)


def _facts(recording: Recording, output: Path, recipe: Recipe) -> dict[str, Any]:
    from vo.outputs.results.summary import mode_of

    return {
        "output": str(output),
        "format": recipe.format,
        "mode": mode_of(recording.rig) if recording.rig.is_stereo else "mono",
        "cameras": len(recording.rig.cameras),
        "frames": len(recording),
        "seconds": recipe.seconds,
        "path_m": round(recording.path_m, 6),
    }
