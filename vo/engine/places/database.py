"""Database of stored keyframes: bounded, and searched by appearance.

Redundant keyframes are removed as in ORB-SLAM: those of whose landmarks 90 % are observed by at
least three others. The order of everything that is returned depends on the keyframes alone.

Source: Mur-Artal et al., "ORB-SLAM", IEEE T-RO 31(5), 2015, sec. VI-E; scores and
groups: Gálvez-López and Tardós, "Bags of binary words", 2012, sec. V.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Self

import numpy as np

from vo.base.types import Descriptors, Floats32, Ints
from vo.engine.places.covisibility import Covisibility, grown
from vo.engine.places.encoding import decode_place, encode_place
from vo.engine.places.inverted_index import InvertedIndex
from vo.engine.places.records import Candidate, Place, PlaceKey
from vo.engine.places.spill import SpilledBlocks
from vo.engine.places.vocabulary import Bag, Vocabulary, similarity

MEMORY_BYTES = 128 * 2**20
_REDUNDANT = 0.9  # fraction of the landmarks, and by how many others they are observed
_OBSERVERS = 3
_NEIGHBOURS = 10  # keyframes of a segment that are stored before or after a query are no candidates
_MIN_RATIO = 0.3  # minimum score relative to that of consecutive keyframes
_MIN_CONSECUTIVE = 0.02  # below, consecutive keyframes are too different to compare with
_GROUP_GAP = 3  # stored keyframes between two of a group
_MAX_CANDIDATES = 5
_RIVAL_RATIO, _MAX_RIVALS = 0.6, 2  # score relative to that of the candidate, and their number
_FIRST_SIZE = 4096


class KeyframeDatabase:
    """Stored keyframes.

    Args:
        memory_bytes: size of the keyframes in memory; the others are in a temporary file.
        folder: of that file; None for the system's folder of temporary files.
    """

    def __init__(
        self,
        vocabulary: Vocabulary,
        *,
        memory_bytes: int = MEMORY_BYTES,
        folder: Path | None = None,
    ) -> None:
        self.vocabulary = vocabulary
        self._blocks = SpilledBlocks(memory_bytes, folder)
        self._index = InvertedIndex(vocabulary.words)
        self._covisibility = Covisibility()
        self._keys: list[PlaceKey] = []  # by number, removed ones included
        self._number_of: dict[PlaceKey, int] = {}
        self._segments: dict[tuple[int, int], int] = {}  # numbers of session and segment
        self._segment = np.zeros(_FIRST_SIZE, np.int32)  # by keyframe, removed ones included
        self._protected: dict[PlaceKey, None] = {}
        self._latest = Bag(np.zeros(0, np.int32), np.zeros(0, np.float32))
        self._consecutive = (0.0, 0)  # sum and number of scores of consecutive keyframes

    def __len__(self) -> int:
        return len(self._number_of)

    def __contains__(self, key: PlaceKey) -> bool:
        return key in self._number_of

    def __iter__(self) -> Iterator[PlaceKey]:
        """Keys in the order in which they were added."""
        return iter(self._number_of)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the temporary file."""
        self._blocks.close()

    @property
    def file_bytes(self) -> int:
        """Size of the temporary file."""
        return self._blocks.file_bytes

    def add(self, place: Place, *, removes_redundant: bool = True) -> tuple[PlaceKey, ...]:
        """Store a keyframe; returns the keys of those removed because they became redundant.

        None is removed while a map is loaded, of which all are needed.

        Raises:
            OutputError: the temporary file cannot be written, such as on a full disk. The keyframe
                is not stored; the others are as before.
            ValueError: its key is stored already.
        """
        if place.key in self._number_of:
            raise ValueError(f"{place.key} is stored already")
        number = len(self._keys)
        self._blocks.add(number, encode_place(place))
        bag = self.vocabulary.bag(place.descriptor)
        self._index.add(bag)
        self._covisibility.add(place.key.session, place.landmarks.id)
        self._keys.append(place.key)
        self._number_of[place.key] = number
        self._segment = grown(self._segment, number + 1, 0)
        name = place.key.session, place.frame.segment
        self._segment[number] = self._segments.setdefault(name, len(self._segments))
        if number and self._segment[number] == self._segment[number - 1]:
            total, count = self._consecutive
            self._consecutive = total + similarity(self._latest, bag), count + 1
        self._latest = bag
        return self._remove_redundant(number) if removes_redundant else ()

    def get(self, key: PlaceKey) -> Place:
        """A stored keyframe.

        Raises:
            KeyError: it is not stored, or no longer.
            OutputError: the temporary file cannot be read.
        """
        return decode_place(self._blocks.get(self._number_of[key]))

    def encoded(self, key: PlaceKey) -> bytes:
        """A stored keyframe as bytes (`encoding`); errors as for `get`."""
        return self._blocks.get(self._number_of[key])

    def remove(self, key: PlaceKey) -> None:
        """Forget a keyframe.

        Raises:
            KeyError: it is not stored.
        """
        number = self._number_of.pop(key)
        self._blocks.remove(number)
        self._index.remove(number)
        self._covisibility.remove(number)
        self._protected.pop(key, None)

    def protect(self, key: PlaceKey) -> None:
        """Keep a keyframe even when it is redundant, such as one that closes a loop."""
        self._protected[key] = None

    def covisible(self, key: PlaceKey, min_landmarks: int = 1) -> list[tuple[PlaceKey, int]]:
        """Keyframes that share landmarks with one, and how many; most first, then as stored."""
        shared = self._covisibility.shared(self._number_of[key])
        order = np.argsort(-shared.landmarks, kind="stable")
        rows = order[shared.landmarks[order] >= min_landmarks]
        keys = (self._keys[n] for n in shared.number[rows].tolist())
        return list(zip(keys, shared.landmarks[rows].tolist(), strict=True))

    def query(self, query: Place | Descriptors) -> list[Candidate]:
        """Stored keyframes that may show the place of a query, best first.

        Of each group of consecutive keyframes only the best one is returned. Scores are relative to
        those of consecutive keyframes.

        Args:
            query: a keyframe, stored or not, or the (N, width) descriptors of an image. For a
                stored keyframe these are no candidates: its neighbours in time, its covisible
                keyframes, and those that are covisible with one of them. For one that is not
                stored, no keyframe of its segment is one.
        """
        return self._groups(self._ratios(query))

    def rivals(self, query: Place, key: PlaceKey) -> list[Candidate]:
        """Other places that a query resembles about as much as that of a candidate, best first.

        Args:
            query: a keyframe, stored or not.
            key: of the candidate. Its neighbours in time and its covisible keyframes, directly or
                through a third one, show the same place.
        """
        ratio, number = self._ratios(query), self._number_of[key]
        limit = _RIVAL_RATIO * float(ratio[number])
        found: list[Candidate] = []
        while len(found) < _MAX_RIVALS:
            ratio[self._connected(number)] = 0.0
            number = int(np.argmax(ratio))
            if ratio[number] <= limit:
                break
            found.append(Candidate(self._keys[number], float(ratio[number])))
        return found

    def _ratios(self, query: Place | Descriptors) -> Floats32:
        """(N,) scores relative to those of consecutive keyframes, 0 for what is no candidate."""
        place = query if isinstance(query, Place) else None
        scores = self._index.scores(self._bag(query))
        expected = self._expected_score()
        if place is not None and place.key in self._number_of:
            number = self._number_of[place.key]
            expected = self._expected_score(number, scores)
            scores[self._connected(number)] = 0.0
        elif place is not None:
            segment = self._segments.get((place.key.session, place.frame.segment), -1)
            scores[self._segment[: len(self._keys)] == segment] = 0.0
        return np.asarray(scores / np.float32(expected))

    def _bag(self, query: Place | Descriptors) -> Bag:
        """The bag of a query; that of the latest keyframe is known."""
        if not isinstance(query, Place):
            return self.vocabulary.bag(query)
        if self._keys and query.key == self._keys[-1]:
            return self._latest
        return self.vocabulary.bag(query.descriptor)

    def _expected_score(self, number: int | None = None, scores: Floats32 | None = None) -> float:
        """Score of consecutive keyframes: with the one before, or the mean of all."""
        if number is not None and scores is not None:
            before = self._neighbours(number, 1)
            best = float(scores[before].max()) if len(before) else 0.0
            if best >= _MIN_CONSECUTIVE:
                return best
        total, count = self._consecutive
        return max(total / count, _MIN_CONSECUTIVE) if count else 1.0

    def _neighbours(self, number: int, reach: int) -> Ints:
        """Up to `reach` keyframes of the same segment stored before one, and as many after."""
        same = self._segment[: len(self._keys)] == self._segment[number]
        numbers = np.flatnonzero(same & self._covisibility.kept)
        at = int(np.searchsorted(numbers, number))
        near = numbers[max(at - reach, 0) : at + reach + 1]
        return np.asarray(near[near != number])

    def _connected(self, number: int) -> Ints:
        """Keyframes near in time or in the map, and the keyframe itself: no loops."""
        direct = self._covisibility.shared(number).number
        further = self._covisibility.shared_with_any(direct)
        near = self._neighbours(number, _NEIGHBOURS)
        return np.concatenate([[number], near, direct, further])

    def _groups(self, ratio: Floats32) -> list[Candidate]:
        """The best keyframe of each group of consecutive ones, in order of their scores.

        In DBoW2 the sum of a group's scores counts: where much looks alike, as in a corridor, a
        whole segment is one group, and the longest comes first.
        """
        numbers = np.flatnonzero(ratio >= _MIN_RATIO)
        if not len(numbers):
            return []
        rank = np.cumsum(self._covisibility.kept)[numbers]
        segment = self._segment[numbers]
        ends = (np.diff(rank) > _GROUP_GAP) | (np.diff(segment) != 0)
        groups = np.split(numbers, np.flatnonzero(ends) + 1)
        best = [int(group[np.argmax(ratio[group])]) for group in groups]
        best.sort(key=lambda number: (-float(ratio[number]), number))
        return [Candidate(self._keys[n], float(ratio[n])) for n in best[:_MAX_CANDIDATES]]

    def _remove_redundant(self, number: int) -> tuple[PlaceKey, ...]:
        """Remove keyframes that became redundant with a new one: some of its covisible ones.

        The first and the last of a segment stay, as do protected ones.
        """
        removed: list[PlaceKey] = []
        others = self._covisibility.shared(number).number
        others = others[self._covisibility.seen_ratios(others, _OBSERVERS) >= _REDUNDANT]
        for n in range(len(others)):
            key = self._keys[others[n]]
            if key in self._protected or len(self._neighbours(int(others[n]), 1)) != 2:
                continue
            # Without the keyframes that were removed just now, landmarks have fewer observers.
            if (
                removed
                and self._covisibility.seen_ratios(others[n : n + 1], _OBSERVERS)[0] < _REDUNDANT
            ):
                continue
            self.remove(key)
            removed.append(key)
        return tuple(removed)
