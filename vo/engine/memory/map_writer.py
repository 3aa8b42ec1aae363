"""Writes the map of a run: its stored keyframes, with those of the map that was loaded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.errors import OutputError
from vo.engine.memory.recognition import Recogniser
from vo.engine.memory.registered_keyframes import scaled_worlds
from vo.engine.places.records import Loop, MarkerVisit, RegisteredKeyframes
from vo.engine.trajectory.metric_segments import MetricSegments

if TYPE_CHECKING:
    from vo.engine.maps.loading import LoadedMap


def check_savable(path: Path, recogniser: Recogniser) -> None:
    """Check that keyframes of the run can be saved with those of the loaded map.

    Raises:
        OutputError: the loaded map is of another camera.
    """
    loaded = recogniser.loaded
    if loaded is not None and loaded.header.camera != recogniser.camera:
        raise OutputError(
            f"the map {path} cannot be saved: the loaded map was made with another camera, "
            "and a map has one camera; leave out `save_map`"
        )


def write_run(
    path: Path,
    source: str,
    recogniser: Recogniser,
    registered: RegisteredKeyframes,
    metric_worlds: set[int],
    loops: Sequence[Loop],
    markers: Iterable[MarkerVisit],
) -> None:
    """Write all stored keyframes that are placed, and those of the loaded map, after all searches.

    `metric_worlds` and `loops` are those of the run, `markers` of both.

    Raises:
        OutputError: the file cannot be written, or the loaded map is of another camera.
    """
    from vo.engine.maps.loading import with_covariance_of
    from vo.engine.maps.map_file import MapHeader, write_map
    from vo.engine.maps.markers import at_keyframes

    check_savable(path, recogniser)
    database, loaded = recogniser.database, recogniser.loaded
    sessions: tuple[str, ...] = (source,)
    if loaded is not None:
        sessions = (*loaded.header.sessions, source)
        registered = with_covariance_of(registered, loaded.placed)
        loops = [*loaded.loops, *loops]
        metric_worlds = metric_worlds | _metric_by(loaded, registered)
    metric = tuple(sorted(metric_worlds))
    header = MapHeader(recogniser.camera, database.vocabulary.id, sessions, metric)
    known = set(registered.keys)
    keyframes = ((k, database.encoded(k)) for k in database if k in known)
    written = {key for key in database if key in known}
    kept = [loop for loop in loops if {loop.earlier, loop.later} <= written]
    write_map(path, header, keyframes, registered, kept, at_keyframes(markers, registered, written))


def in_metres(
    registered: RegisteredKeyframes, segments: Mapping[int, int], metric: MetricSegments
) -> tuple[RegisteredKeyframes, set[int]]:
    """Keyframes of one camera, converted where there is a scale; the worlds in metres then.

    `segments` are those of keyframes of the run, by row.
    """
    scales = {row: metric.scale(segment) for row, segment in segments.items()}
    factors = {row: scale.value for row, scale in scales.items() if scale is not None}
    rows = [row for row, segment in segments.items() if metric.is_metric(segment)]
    return scaled_worlds(registered, factors), {int(registered.world[row]) for row in rows}


def _metric_by(loaded: LoadedMap, registered: RegisteredKeyframes) -> set[int]:
    """Numbers of the placed worlds that are metric by the map."""
    world_of = dict(zip(loaded.placed.keys, loaded.placed.world.tolist(), strict=True))
    return {
        int(world)
        for key, world in zip(registered.keys, registered.world, strict=True)
        if world_of.get(key) in loaded.header.metric_worlds
    }
