"""Recognition of stored places, in a thread of its own."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, TypeVar

from vo.base.errors import OutputError
from vo.base.frozen import frozen
from vo.base.scheduling import give_way
from vo.base.types import Camera
from vo.engine.memory.search_pauses import SearchPauses
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.records import Loop, Place, PlaceKey, RegisteredKeyframes

if TYPE_CHECKING:  # imported only where there are candidates, or maps: it takes a few ms each
    from vo.engine.loop_verification.loop_verifier import LoopVerifier
    from vo.engine.loop_verification.screening import Screening
    from vo.engine.maps.loading import LoadedMap

T = TypeVar("T")

_log = logging.getLogger(__name__)

SUCCESSION = 3  # newest keyframes that the verifier needs
_NEIGHBOURS = 6  # keyframes beside a candidate with landmarks in common
_MIN_SHARED = 15  # landmarks
_MAX_CANDIDATES = 3  # that are verified per keyframe, so that its cost is bounded


@frozen(eq=False)
class Recognised:
    """Result of the search for the place of a keyframe.

    Attributes:
        removed: keyframes that became redundant.
        is_familiar: whether there were candidates that pass the screening.
    """

    place: Place
    removed: tuple[PlaceKey, ...] = ()
    loops: tuple[Loop, ...] = ()
    is_familiar: bool = False


class Recogniser:
    """Stores keyframes one by one, and searches for earlier ones of the same place.

    All work on the database is done in one thread, in the order of the calls, so that no result
    depends on the time at which it is requested.

    Args:
        judges: makes what chooses the candidates that are verified, and what decides on them.
        threads: with one, all work is done at once.
        localizes: whether only the loaded map is searched, and keyframes are not stored.
    """

    def __init__(
        self,
        database: KeyframeDatabase,
        judges: Callable[[], tuple[Screening, LoopVerifier]],
        camera: Camera,
        threads: int,
        loaded: LoadedMap | None = None,
        *,
        localizes: bool = False,
    ) -> None:
        self.database = database
        self._make_judges = judges
        self.camera = camera
        self.loaded = loaded
        self._localizes = localizes
        self._recent: deque[Place] = deque(maxlen=SUCCESSION)  # newest first, of one segment
        self._doubted: list[PlaceKey] = []  # keyframes before which odometry may be wrong
        self._pauses = SearchPauses(database)
        self._is_full = False  # whether keyframes could not be kept
        self._pool = ThreadPoolExecutor(1, "places", give_way) if threads > 1 else None

    @cached_property
    def _judges(self) -> tuple[Screening, LoopVerifier]:
        return self._make_judges()

    def add(self, place: Place, *, searches: bool = True) -> Future[Recognised]:
        """Store a keyframe, and search for its place if no loop is known of it yet."""
        search = partial(self._recognise, place, searches=searches)
        return self._start(lambda: self._result(place, search))

    def search(self, places: Sequence[Place]) -> Future[Recognised]:
        """Search for the place of the first of some keyframes, newest first, not stored yet."""
        return self._start(lambda: self._result(places[0], partial(self._find, places)))

    def unconfirmed(self, registered: RegisteredKeyframes) -> tuple[PlaceKey, ...]:
        """Those of the keyframes `registered.wrong` whose new motion the images do not confirm."""
        from vo.engine.loop_verification.repair_check import unconfirmed_repairs

        return self._start(
            lambda: unconfirmed_repairs(self.database, self.camera, registered)
        ).result()

    def _start(self, work: Callable[[], T]) -> Future[T]:
        if self._pool is not None:
            return self._pool.submit(work)
        future: Future[T] = Future()
        future.set_result(work())
        return future

    def _result(self, place: Place, work: Callable[[], Recognised]) -> Recognised:
        """The result of a search; on a full disk, no further keyframe is stored or searched."""
        if self._is_full:
            return Recognised(place)
        try:
            return work()
        except OutputError as error:
            self._is_full = True
            _log.warning("places are recognised no longer: %s", error)
            return Recognised(place)

    def remove(self, keys: tuple[PlaceKey, ...]) -> None:
        """Forget keyframes; all results must be known."""
        for key in keys:
            if key in self.database:
                self.database.remove(key)
        self._recent.clear()
        self._doubted = [key for key in self._doubted if key not in keys]

    def close(self) -> None:
        """End the thread, and remove temporary files."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        self.database.close()

    def _recognise(self, place: Place, *, searches: bool) -> Recognised:
        if self._recent and self._recent[0].frame.segment != place.frame.segment:
            self._recent.clear()
            self._pauses.begin_segment()
        self._recent.appendleft(place)
        if place.is_doubted:
            self._doubted.append(place.key)
        removed = () if self._localizes else self.database.add(place)
        if not searches or self._pauses.skips(place):
            return Recognised(place, removed)
        found = self._find(list(self._recent))
        return replace(found, removed=(*removed, *self._pauses.note(place, found.loops)))

    def _find(self, later: Sequence[Place]) -> Recognised:
        """Loops of the first of consecutive keyframes, newest first.

        Odometry decides whether a place of its own segment is the right one. To another segment, or
        where odometry is doubted, all places that look the same are needed: the pose graph refuses
        one that exists twice.
        """
        is_familiar = False
        for candidate in self.database.query(later[0])[:_MAX_CANDIDATES]:
            earlier = self.database.get(candidate.key)
            screening, _ = self._judges
            if not screening.passes(later[0], earlier, self.camera, self._camera_of(earlier)):
                continue
            is_familiar = True
            loop = self._verified(later, earlier)
            if loop is None:
                continue
            loops = [loop]
            if not self._is_connected(earlier, later[0]):
                rivals = self.database.rivals(later[0], candidate.key)
                also = (self._verified(later, self.database.get(rival.key)) for rival in rivals)
                loops += [each for each in also if each is not None]
            for each in loops:
                self.database.protect(each.earlier)
            if not self._localizes:
                self.database.protect(later[0].key)
            return Recognised(later[0], loops=tuple(loops), is_familiar=True)
        return Recognised(later[0], is_familiar=is_familiar)

    def _is_connected(self, earlier: Place, later: Place) -> bool:
        """Whether odometry that is not doubted leads from one keyframe to the other."""
        of_run = earlier.key.session == later.key.session
        if not of_run or earlier.frame.segment != later.frame.segment:
            return False
        return not any(earlier.key < key <= later.key for key in self._doubted)

    def _verified(self, later: Sequence[Place], earlier: Place) -> Loop | None:
        """The loop from the newest keyframe to an earlier one, None if they are other places."""
        beside = [earlier]
        for key, _ in self.database.covisible(earlier.key, _MIN_SHARED):
            if len(beside) > _NEIGHBOURS:
                break
            place = self.database.get(key)
            if place.frame.segment == earlier.frame.segment:
                beside.append(place)
        camera = self._camera_of(earlier)
        _, verifier = self._judges
        result = verifier.verify(later, beside, self.camera, camera)
        return result if isinstance(result, Loop) else None

    def _camera_of(self, place: Place) -> Camera | None:
        """That of the loaded map for one of its keyframes."""
        is_loaded = self.loaded is not None and place.key in self.loaded.frames
        return self.loaded.header.camera if self.loaded is not None and is_loaded else None
