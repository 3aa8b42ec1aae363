"""`vo map`: what a map file contains, its points for other programs, and two maps as one."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Any

from vo.cli import options
from vo.cli.blocks import argument, option
from vo.cli.echo import echo


class MapAction(StrEnum):
    """What to do."""

    INFO = "info"
    EXPORT = "export"
    MERGE = "merge"


def map_command(
    action: MapAction = argument(
        "info: check a map and list what is in it; export: write its points and markers as "
        "PLY; merge: write two maps that share a place as one.",
        metavar="ACTION",
    ),
    files: list[Path] = argument("Map file; two of them to merge.", metavar="FILE..."),
    *,
    output: Path | None = option(
        "File to write: PLY (export), or a map (merge).",
        "--output",
        "-o",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    ),
    world: int | None = option(
        "World to export; by default that with most keyframes.",
        default=None,
        metavar="N",
        panel=options.INPUT,
    ),
    vocabulary: Path | None = option(
        "Vocabulary of both maps (merge); by default the built-in one.",
        default=None,
        metavar="FILE",
        panel=options.INPUT,
    ),
    printing: options.Printing,
) -> None:
    """Check a map file, export it, or merge two.

    List what is in a map, and check every part of it:

      vo map info house.map

    Write its points as a PLY file:

      vo map export house.map -o house.ply

    Write two maps that share a place as one:

      vo map merge ground.map upper.map -o house.map
    """
    from vo.base.errors import ConfigError
    from vo.outputs.results.output_paths import refuse_to_overwrite

    refuse_to_overwrite(files, [output])
    expected = 2 if action is MapAction.MERGE else 1
    if len(files) != expected:
        what = "one map" if expected == 1 else "two maps"
        raise ConfigError(f"`vo map {action.value}` takes {what}, not {len(files)}")
    if (action is MapAction.INFO) != (output is None):
        raise ConfigError("-o FILE belongs to `vo map export` and `vo map merge`, which need it")
    result = _do(action, files, output, world, vocabulary)
    printing.show(lambda: result, lambda: _print(result))


def _do(
    action: MapAction,
    files: list[Path],
    output: Path | None,
    world: int | None,
    vocabulary: Path | None,
) -> dict[str, Any]:
    from vo.api import maps
    from vo.tools.maps.contents import chosen_world

    if output is None:
        return maps.info(files[0])
    if action is MapAction.MERGE:
        recognised = maps.merge(files[0], files[1], output, vocabulary=vocabulary)
        return {"output": str(output), "recognised": recognised}
    with maps.load(files[0]) as map_file:
        chosen = chosen_world(map_file, world)
    count = maps.export(files[0], output, world=chosen)
    return {"output": str(output), "world": chosen, "points": count}


def _print(result: dict[str, Any]) -> None:
    if "recognised" in result:
        echo(f"{result['recognised']} keyframes recognised in both maps: {result['output']}")
        return
    if "output" in result:
        echo(f"{result['points']} points of world {result['world']}: {result['output']}")
        return
    echo(f"{result['path']}: intact, {result['bytes'] / 1e6:.1f} MB")
    echo(f"sessions: {', '.join(result['sessions'])}")
    for row in result["worlds"]:
        echo(f"world {row['world']}: {row['keyframes']} keyframes, lengths in {row['length_unit']}")
    for row in result["markers"]:
        where = " ".join(f"{value:.3f}" for value in row["position"])
        echo(
            f"marker {row['id']} of {row['dictionary']}, {row['length_m']:g} m: at {where} "
            f"in world {row['world']}"
        )
    echo(f"loops: {result['loops']}")
    echo(f"observations of landmarks: {result['observations']}")
    echo(f"camera: {result['camera']}, vocabulary {result['vocabulary']}")
