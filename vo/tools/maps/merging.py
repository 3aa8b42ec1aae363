"""Two maps that share a place as one."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from vo.base.config import Config
from vo.base.errors import ConfigError
from vo.engine.backend.pose_graph import PoseGraph
from vo.engine.maps.loading import LoadedMap, load_map, with_covariance_of
from vo.engine.maps.map_file import MapFile, MapHeader, write_map
from vo.engine.memory.memory_creation import make_judges
from vo.engine.memory.recognition import SUCCESSION, Recogniser
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.encoding import encode_place
from vo.engine.places.records import Loop, Place, PlaceKey
from vo.engine.places.vocabulary import Vocabulary


def merge_maps(first: Path, second: Path, output: Path, vocabulary: Vocabulary) -> int:
    """Write two maps as one, whose worlds are connected where they show the same place.

    Keyframes of the second map are searched in the first one, as those of a run are in a loaded
    map. As maps do not record the settings of their runs, the default ones are used. The worlds of
    both are rigid: nothing in them moves.

    `first`: map whose worlds keep their frames and numbers. `second`: map whose sessions and worlds
    are numbered after those of the first one.

    Returns the number of keyframes of the second map that were recognised.

    Raises:
        SourceError: a map is missing or damaged.
        ConfigError: they cannot be compared, or share no place.
        OutputError: the file cannot be written.
    """
    with MapFile(second) as added, KeyframeDatabase(vocabulary) as database:
        is_metric = len(added) > 0 and added.place(added.keys[0]).is_metric
        loaded = load_map(first, database, is_metric=is_metric)
        _check(added, first, loaded.header, vocabulary)
        sessions = len(loaded.header.sessions)
        places = list(_in_order(added, sessions))
        loops = _search(database, loaded, places)
        worlds = int(loaded.placed.world.max(initial=-1)) + 1
        keys = tuple(_moved(key, sessions) for key in added.keys)
        registered = replace(added.placed, keys=keys, world=added.placed.world + worlds)
        graph = PoseGraph()
        graph.add_map(loaded.placed, is_metric=is_metric)
        graph.add_map(registered, is_metric=is_metric)
        graph.submit(loops)
        both = graph.result()
        rejected = {(loop.earlier, loop.later) for loop in both.rejected}
        kept = [loop for loop in loops if (loop.earlier, loop.later) not in rejected]
        if not kept:
            raise ConfigError(
                f"the maps {first} and {second} share no place that is recognised: they stay two "
                "maps; record a session that passes through both, with three keyframes or more in "
                "places of each"
            )
        keyframes = [(key, database.encoded(key)) for key in loaded.placed.keys]
        keyframes += [(place.key, encode_place(place)) for place in places]
        names = (*loaded.header.sessions, *added.header.sessions)
        own_worlds = {worlds + world for world in added.header.metric_worlds}
        metric = {*loaded.header.metric_worlds, *own_worlds} & set(both.world.tolist())
        header = MapHeader(loaded.header.camera, vocabulary.id, names, tuple(sorted(metric)))
        both = with_covariance_of(with_covariance_of(both, loaded.placed), registered)
        own = [_of_later_session(loop, sessions) for loop in added.loops]
        markers = [each._replace(key=_moved(each.key, sessions)) for each in added.markers]
        markers = [*loaded.markers, *markers]
        write_map(output, header, keyframes, both, [*loaded.loops, *own, *kept], markers)
        return len(kept)


def _check(added: MapFile, first: Path, header: MapHeader, vocabulary: Vocabulary) -> None:
    second = added.path
    if added.header.vocabulary != vocabulary.id:
        raise ConfigError(f"the maps {first} and {second} were made with different vocabularies")
    if added.header.camera != header.camera:
        raise ConfigError(
            f"the maps {first} and {second} were made with different cameras, and a map has one "
            "camera"
        )
    if not len(added):
        raise ConfigError(f"the map {second} has no keyframes")


def _in_order(added: MapFile, sessions: int) -> Iterator[Place]:
    """The keyframes of the second map, in the order of their sessions and times."""
    for key in sorted(added.keys):
        place = added.place(key)
        yield replace(place, key=_moved(key, sessions))


def _search(database: KeyframeDatabase, loaded: LoadedMap, places: list[Place]) -> list[Loop]:
    """Loops from keyframes to those of the first map."""
    judges = partial(make_judges, database.vocabulary, Config())
    recogniser = Recogniser(database, judges, loaded.header.camera, 1, loaded, localizes=True)
    recent: deque[Place] = deque(maxlen=SUCCESSION)
    found: list[Loop] = []
    for place in places:
        if recent and _segment(recent[0]) != _segment(place):
            recent.clear()
        recent.appendleft(place)
        found += recogniser.search(list(recent)).result().loops
    return found


def _segment(place: Place) -> tuple[int, int]:
    return place.key.session, place.frame.segment


def _of_later_session(loop: Loop, sessions: int) -> Loop:
    earlier, later = _moved(loop.earlier, sessions), _moved(loop.later, sessions)
    return replace(loop, earlier=earlier, later=later)


def _moved(key: PlaceKey, sessions: int) -> PlaceKey:
    return PlaceKey(key.session + sessions, key.keyframe)
