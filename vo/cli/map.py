"""`vo map`: what a map file contains, and its points for other programs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vo.cli import options
from vo.cli.echo import echo, echo_json

if TYPE_CHECKING:
    from vo.places.map_file import MapFile


class MapAction(StrEnum):
    """What to do."""

    INFO = "info"
    EXPORT = "export"


Action = Annotated[
    MapAction,
    typer.Argument(
        metavar="ACTION",
        help="info: check a map and list what is in it; export: write its points as PLY.",
    ),
]
File = Annotated[Path, typer.Argument(metavar="FILE", help="Map file.")]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="PLY file to write (export).",
        rich_help_panel=options.OUTPUT,
    ),
]
World = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="World to export; by default that with most keyframes.",
        rich_help_panel=options.INPUT,
    ),
]


def map_command(
    action: Action,
    file: File,
    output: Output = None,
    world: World = None,
    json_output: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Check a map file, and export it.

    List what is in a map, and check every part of it:

      vo map info house.map

    Write its points as a PLY file:

      vo map export house.map -o house.ply
    """
    from vo.errors import ConfigError
    from vo.places.map_file import MapFile
    from vo.places.map_points import export_ply
    from vo.results.output_paths import refuse_to_overwrite

    refuse_to_overwrite([file], [output])
    if (action is MapAction.EXPORT) != (output is not None):
        raise ConfigError("-o FILE.ply belongs to `vo map export`, which needs it")
    with MapFile(file) as map_file:
        result = _contents(map_file)
        if output is not None:
            worlds = {row["world"]: row["keyframes"] for row in result["worlds"]}
            if not worlds or (world is not None and world not in worlds):
                known = ", ".join(map(str, worlds)) or "none"
                raise ConfigError(f"{file} has no such world; its worlds are: {known}")
            chosen = max(worlds, key=lambda n: (worlds[n], -n)) if world is None else world
            count = export_ply(map_file, output, chosen)
            result = {"output": str(output), "world": chosen, "points": count}
    if json_output:
        echo_json(result)
    elif not quiet:
        _print(result)


def _contents(map_file: MapFile) -> dict[str, Any]:
    """What is in a map; every keyframe is read, and so its checksum verified."""
    import numpy as np

    header = map_file.header
    observations = sum(len(map_file.place(key).landmarks.id) for key in map_file.keys)
    worlds, counts = np.unique(map_file.placed.world, return_counts=True)
    pairs = zip(worlds.tolist(), counts.tolist(), strict=True)
    return {
        "path": str(map_file.path),
        "bytes": map_file.path.stat().st_size,
        "sessions": list(header.sessions),
        "keyframes": len(map_file),
        "worlds": [{"world": world, "keyframes": count} for world, count in pairs],
        "loops": len(map_file.loops),
        "observations": observations,
        "camera": f"{header.camera.width}x{header.camera.height}",
        "vocabulary": header.vocabulary,
    }


def _print(result: dict[str, Any]) -> None:
    if "output" in result:
        echo(f"{result['points']} points of world {result['world']}: {result['output']}")
        return
    echo(f"{result['path']}: intact, {result['bytes'] / 1e6:.1f} MB")
    echo(f"sessions: {', '.join(result['sessions'])}")
    for row in result["worlds"]:
        echo(f"world {row['world']}: {row['keyframes']} keyframes")
    echo(f"loops: {result['loops']}")
    echo(f"observations of landmarks: {result['observations']}")
    echo(f"camera: {result['camera']}, vocabulary {result['vocabulary']}")
