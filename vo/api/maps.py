"""Maps that runs have saved (`vo.maps`), as `vo map` handles them.

`vo.run(..., save_map=FILE)` saves one, and the setting `memory.map` continues in one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vo.engine.maps.map_file import MapFile
from vo.engine.places.vocabulary_file import built_in_vocabulary, read_vocabulary
from vo.outputs.results.output_paths import refuse_to_overwrite
from vo.tools.maps.contents import chosen_world, export_ply, map_contents
from vo.tools.maps.merging import merge_maps


def load(path: str | Path) -> MapFile:
    """Open a map, whose keyframes are read on request; close it at the end, or use `with`.

    Raises:
        SourceError: it is missing, something else, damaged, or of a newer version.
    """
    return MapFile(Path(path))


def info(path: str | Path) -> dict[str, Any]:
    """Check a map, and list what is in it: the values of `vo map info --json`.

    Raises:
        SourceError: it is missing or damaged.
    """
    with MapFile(Path(path)) as map_file:
        return map_contents(map_file)


def merge(
    first: str | Path,
    second: str | Path,
    output: str | Path,
    *,
    vocabulary: str | Path | None = None,
) -> int:
    """Write two maps that share a place as one.

    Args:
        first: map whose worlds keep their frames and numbers.
        second: the other map.
        output: file to write.
        vocabulary: file of the vocabulary of both, None for the built-in one.

    Returns:
        The number of keyframes of the second map that were recognised in the first.

    Raises:
        SourceError: a map is missing or damaged.
        ConfigError: they share no place, or cannot be compared.
        OutputError: the file cannot be written, or is one of the maps.
    """
    paths = Path(first), Path(second)
    refuse_to_overwrite(paths, [Path(output)])
    words = built_in_vocabulary() if vocabulary is None else read_vocabulary(Path(vocabulary))
    return merge_maps(*paths, Path(output), words)


def export(path: str | Path, output: str | Path, *, world: int | None = None) -> int:
    """Write the points of one world of a map as a PLY file.

    Args:
        path: the map.
        output: file to write.
        world: its number, None for that with most keyframes.

    Returns:
        The number of points.

    Raises:
        SourceError: the map is missing or damaged.
        ConfigError: it has no such world.
        OutputError: the file cannot be written, or is the map.
    """
    refuse_to_overwrite([Path(path)], [Path(output)])
    with MapFile(Path(path)) as map_file:
        return export_ply(map_file, Path(output), chosen_world(map_file, world))
