"""Fixed transforms between the coordinate frames of a log."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from vo.base.errors import VoError
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats
from vo.recordings.formats.messages import TransformsMessage
from vo.recordings.sources.logs.log import Entry, Log, Topic

_log = logging.getLogger(__name__)

_MAX_MESSAGES = 200
_MAX_CHANGE = 1e-6
"""Maximum change of a fixed transform, in metres and radians; constants are repeated exactly."""


class FrameTree:
    """The transforms between frames that are fixed to each other."""

    def __init__(self) -> None:
        self._parent_from_child: dict[tuple[str, str], Floats] = {}
        self._moving: set[tuple[str, str]] = set()

    def add(self, message: TransformsMessage) -> None:
        """Add transforms; one that changes is not used."""
        for each in message.transforms:
            pair = (each.parent, each.child)
            first = self._parent_from_child.setdefault(pair, each.parent_from_child)
            if np.abs(first - each.parent_from_child).max() > _MAX_CHANGE:
                self._moving.add(pair)

    @property
    def moving(self) -> list[tuple[str, str]]:
        """Pairs of parent and child whose transform changes, sorted."""
        return sorted(self._moving)

    def between(self, a: str, b: str) -> Floats | None:
        """The (4, 4) transform `a_from_b`, None without a chain of fixed transforms."""
        a_from_b = np.eye(4)
        for frame, other in (steps := chain(self._fixed(), a, b)):
            stored = self._parent_from_child.get((frame, other))
            known = inverse(self._parent_from_child[other, frame]) if stored is None else stored
            a_from_b = a_from_b @ known
        return a_from_b if steps or a == b else None

    def root(self, frame: str) -> str:
        """The topmost ancestor that is fixed to a frame, or the frame itself."""
        seen = {frame}
        while True:
            parents = [p for p, c in self._fixed() if c == frame and p not in seen]
            if not parents:
                return frame
            frame = parents[0]
            seen.add(frame)

    def _fixed(self) -> list[tuple[str, str]]:
        return [pair for pair in self._parent_from_child if pair not in self._moving]


def chain(pairs: Iterable[tuple[str, str]], start: str, end: str) -> list[tuple[str, str]]:
    """The shortest chain of transforms from one frame to another; empty if there is none."""
    neighbours: dict[str, list[str]] = {}
    for a, b in pairs:
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    chains: dict[str, list[tuple[str, str]]] = {start: []}
    waiting = deque([start])
    while waiting:
        frame = waiting.popleft()
        for other in neighbours.get(frame, []):
            if other not in chains:
                chains[other] = [*chains[frame], (frame, other)]
                waiting.append(other)
    return chains.get(end, [])


def read_frame_tree(log: Log, listed: Sequence[tuple[Topic, Sequence[Entry]]]) -> FrameTree:
    """Read the fixed transforms of a log; about 200 messages of a topic with moving frames."""
    tree = FrameTree()
    for topic, entries in listed:
        step = 1 if topic.name.endswith("_static") else max(1, len(entries) // _MAX_MESSAGES)
        _add_transforms(tree, log, topic, entries[::step])
    return tree


def _add_transforms(tree: FrameTree, log: Log, topic: Topic, entries: Sequence[Entry]) -> None:
    errors = []
    for entry in entries:
        try:
            message = topic.codec.decode(log.read(entry))
        except VoError as error:
            errors.append(error)
            continue
        if isinstance(message, TransformsMessage):
            tree.add(message)
    if errors:
        _log.warning(
            "%s: %d of %d sampled transforms cannot be read and are skipped; first error: %s",
            topic.name,
            len(errors),
            len(entries),
            errors[0],
        )
