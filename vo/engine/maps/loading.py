"""A map of earlier runs that is loaded into the memory of a run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from vo.base.errors import ConfigError
from vo.engine.mapping.keyframe import FrameId
from vo.engine.maps.map_file import MapFile, MapHeader
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.records import Loop, MarkerVisit, PlaceKey, RegisteredKeyframes


@dataclass(frozen=True, eq=False)
class LoadedMap:
    """A map whose keyframes are in the database; `frames` are those of its keyframes."""

    header: MapHeader
    placed: RegisteredKeyframes
    loops: tuple[Loop, ...]
    markers: tuple[MarkerVisit, ...]
    frames: dict[PlaceKey, FrameId]


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
        return LoadedMap(header, file.placed, file.loops, file.markers, frames)


def with_covariance_of(
    registered: RegisteredKeyframes, loaded: RegisteredKeyframes
) -> RegisteredKeyframes:
    """Registered keyframes, those of a loaded map with the covariances that they had in it."""
    covariance = registered.covariance.copy()
    known = dict(zip(loaded.keys, loaded.covariance, strict=True))
    for n, key in enumerate(registered.keys):
        if key in known:
            covariance[n] = known[key]
    return replace(registered, covariance=covariance)
