"""What a map contains."""

from __future__ import annotations

from typing import Any

import numpy as np

from vo.base.errors import ConfigError
from vo.engine.maps.map_file import MapFile
from vo.engine.maps.markers import listed_markers


def map_contents(map_file: MapFile) -> dict[str, Any]:
    """Plain values for JSON; every keyframe is read, and so its checksum verified.

    Raises:
        SourceError: a keyframe is damaged.
    """
    header = map_file.header
    observations, metric = 0, set(header.metric_worlds)
    for key, world in zip(map_file.keys, map_file.placed.world.tolist(), strict=True):
        place = map_file.place(key)
        observations += len(place.landmarks.id)
        if place.is_metric:
            metric.add(world)
    worlds, counts = np.unique(map_file.placed.world, return_counts=True)
    pairs = zip(worlds.tolist(), counts.tolist(), strict=True)
    return {
        "path": str(map_file.path),
        "bytes": map_file.path.stat().st_size,
        "sessions": list(header.sessions),
        "keyframes": len(map_file),
        "worlds": [
            {
                "world": world,
                "keyframes": count,
                "length_unit": "m" if world in metric else "map units",
            }
            for world, count in pairs
        ],
        "metric_worlds": list(header.metric_worlds),
        "loops": len(map_file.loops),
        "observations": observations,
        "camera": f"{header.camera.width}x{header.camera.height}",
        "vocabulary": header.vocabulary,
        "markers": listed_markers(map_file.markers, map_file.placed),
    }


def chosen_world(map_file: MapFile, world: int | None) -> int:
    """The number of a world of a map; without one, that with most keyframes.

    Raises:
        ConfigError: the map has no such world.
    """
    numbers, counts = np.unique(map_file.placed.world, return_counts=True)
    known = numbers.tolist()
    if not known or (world is not None and world not in known):
        text = ", ".join(map(str, known)) or "none"
        raise ConfigError(f"{map_file.path} has no such world; its worlds are: {text}")
    return int(numbers[np.argmax(counts)]) if world is None else world
