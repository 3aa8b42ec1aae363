"""Recognition of stored places, in a thread of its own."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from vo.errors import OutputError
from vo.memory.loaded_map import LoadedMap, with_covariance_of
from vo.places.database import KeyframeDatabase
from vo.places.loop_verification import LoopVerifier
from vo.places.map_file import MapHeader, write_map
from vo.places.records import Candidate, Loop, Place, PlacedKeyframes, PlaceKey
from vo.scheduling import give_way
from vo.types import Camera

_SUCCESSION = 4  # newest keyframes given to the verifier
_NEIGHBOURS = 6  # keyframes beside a candidate with landmarks in common
_MIN_SHARED = 15  # landmarks
_MAX_CANDIDATES = 3  # that are verified per keyframe, so that its cost is bounded


@dataclass(frozen=True, eq=False)
class Recognised:
    """Result of the search for the place of a keyframe.

    Attributes:
        place: the keyframe.
        removed: keyframes that became redundant.
        loop: to an earlier keyframe, or None.
    """

    place: Place
    removed: tuple[PlaceKey, ...]
    loop: Loop | None


class Recogniser:
    """Stores keyframes one by one, and searches for earlier ones of the same place.

    All work on the database is done in one thread, in the order of the calls.

    Args:
        database: of stored keyframes.
        verifier: decides on candidates.
        camera: ideal (rectified) camera of the keyframes.
        threads: with one, the search is done when the result is requested.
        loaded: map whose keyframes are in the database, or None.
        localizes: whether only the loaded map is searched, and keyframes are not stored.
    """

    def __init__(
        self,
        database: KeyframeDatabase,
        verifier: LoopVerifier,
        camera: Camera,
        threads: int,
        loaded: LoadedMap | None = None,
        *,
        localizes: bool = False,
    ) -> None:
        self._database = database
        self._verifier = verifier
        self._camera = camera
        self._loaded = loaded
        self._localizes = localizes
        self._recent: deque[Place] = deque(maxlen=_SUCCESSION)  # newest first, of one segment
        self._pool = ThreadPoolExecutor(1, "places", give_way) if threads > 1 else None
        self._future: Future[Recognised] | None = None
        self._place: Place | None = None

    def submit(self, place: Place) -> None:
        """Store a keyframe and search for its place, after the last result was requested."""
        if self._pool is None:
            self._place = place
        else:
            self._future = self._pool.submit(self._recognise, place)

    def result(self) -> Recognised | None:
        """Wait for the result of the keyframe that was submitted, None without one."""
        future, self._future = self._future, None
        place, self._place = self._place, None
        if future is not None:
            return future.result()
        return None if place is None else self._recognise(place)

    def remove(self, keys: tuple[PlaceKey, ...]) -> None:
        """Forget keyframes; there must be no keyframe without a result."""
        for key in keys:
            if key in self._database:
                self._database.remove(key)
        self._recent.clear()

    def check_savable(self, path: Path) -> None:
        """Check that keyframes of the run can be saved with those of the loaded map.

        Raises:
            OutputError: the loaded map is of another camera.
        """
        if self._loaded is not None and self._loaded.camera != self._camera:
            raise OutputError(
                f"the map {path} cannot be saved: the loaded map was made with another camera, "
                "and a map has one camera; leave out --save-map"
            )

    def save_map(
        self, path: Path, source: str, placed: PlacedKeyframes, loops: Sequence[Loop]
    ) -> None:
        """Write all stored keyframes that are placed; none may be without a result.

        Raises:
            OutputError: the file cannot be written, or the loaded map is of another camera.
        """
        self.check_savable(path)
        sessions: tuple[str, ...] = (source,)
        if self._loaded is not None:
            sessions = (*self._loaded.sessions, source)
            placed = with_covariance_of(placed, self._loaded.placed)
            loops = [*self._loaded.loops, *loops]
        header = MapHeader(self._camera, self._database.vocabulary.id, sessions)
        known = set(placed.keys)
        keyframes = ((k, self._database.encoded(k)) for k in self._database if k in known)
        kept = [loop for loop in loops if {loop.earlier, loop.later} <= known]
        write_map(path, header, keyframes, placed, kept)

    def close(self) -> None:
        """End the thread, and remove temporary files."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        self._database.close()

    def _recognise(self, place: Place) -> Recognised:
        if self._recent and self._recent[0].frame.segment != place.frame.segment:
            self._recent.clear()
        self._recent.appendleft(place)
        removed = () if self._localizes else self._database.add(place)
        loop = None
        for candidate in self._database.query(place)[:_MAX_CANDIDATES]:
            loop = self._verified(candidate)
            if loop is not None:
                self._database.protect(loop.earlier)
                if not self._localizes:
                    self._database.protect(loop.later)
                break
        return Recognised(place, removed, loop)

    def _verified(self, candidate: Candidate) -> Loop | None:
        """The loop from the newest keyframe to a candidate, None if they are not the same place."""
        earlier = self._database.get(candidate.key)
        beside = [earlier]
        for key, _ in self._database.covisible(candidate.key, _MIN_SHARED):
            if len(beside) > _NEIGHBOURS:
                break
            place = self._database.get(key)
            if place.frame.segment == earlier.frame.segment:
                beside.append(place)
        loaded = self._loaded
        is_loaded = loaded is not None and candidate.key in loaded.frames
        camera = loaded.camera if loaded is not None and is_loaded else None
        result = self._verifier.verify(list(self._recent), beside, self._camera, camera)
        return result if isinstance(result, Loop) else None
