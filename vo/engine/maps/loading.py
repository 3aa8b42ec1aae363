"""A map of earlier runs that is loaded into the memory of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vo.base.errors import ConfigError
from vo.base.types import Camera
from vo.engine.mapping.keyframe import FrameId
from vo.engine.maps.map_file import MapFile
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.records import Loop, MarkerVisit, PlacedKeyframes, PlaceKey


@dataclass(frozen=True, eq=False)
class LoadedMap:
    """A map whose keyframes are in the database.

    Attributes:
        camera: rectified camera of its keyframes.
        is_metric: (n,) whether lengths of each are metres.
        metric_worlds: numbers of the worlds of one camera whose lengths are metres.
    """

    camera: Camera
    sessions: tuple[str, ...]
    placed: PlacedKeyframes
    is_metric: Sequence[bool]
    loops: tuple[Loop, ...]
    frames: dict[PlaceKey, FrameId]
    metric_worlds: tuple[int, ...]
    markers: tuple[MarkerVisit, ...]


def load_map(path: Path, database: KeyframeDatabase, *, is_metric: bool) -> LoadedMap:
    """Read a map, and store its keyframes.

    Raises:
        SourceError: the file is missing, damaged, or no map.
        ConfigError: it is of another kind of camera, or of another vocabulary.
    """
    with MapFile(path) as file:
        header = file.header
        if header.vocabulary != database.vocabulary.id:
            raise ConfigError(
                f"the map {path} was made with another vocabulary; "
                "give the same one by `memory.vocabulary`, or make the map anew"
            )
        frames: dict[PlaceKey, FrameId] = {}
        metric: list[bool] = []
        for key in file.keys:
            place = file.place(key)
            if place.is_metric != is_metric:
                kinds = ("stereo or depth", "one camera")
                of_map, of_run = kinds if place.is_metric else kinds[::-1]
                raise ConfigError(
                    f"the map {path} was made with {of_map}, this run has {of_run}: "
                    "their lengths cannot be compared; use a map of the same kind"
                )
            database.add(place, removes_redundant=False)
            frames[key] = place.frame
            metric.append(place.is_metric)
        return LoadedMap(
            header.camera,
            header.sessions,
            file.placed,
            metric,
            file.loops,
            frames,
            header.metric_worlds,
            file.markers,
        )


def with_covariance_of(placed: PlacedKeyframes, loaded: PlacedKeyframes) -> PlacedKeyframes:
    """Placed keyframes, those of a loaded map with the covariances that they had in it."""
    covariance = placed.covariance.copy()
    row_of = {key: n for n, key in enumerate(loaded.keys)}
    for n, key in enumerate(placed.keys):
        if key in row_of:
            covariance[n] = loaded.covariance[row_of[key]]
    return PlacedKeyframes(
        placed.keys,
        placed.world,
        placed.world_from_cam,
        placed.scale,
        np.asarray(covariance),
        placed.rejected,
    )
