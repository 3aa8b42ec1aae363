"""The first map of a rig whose cameras see too little in common: from the motion of one of them.

The poses of the cameras on the body then have a scale of their own, in which a metre has an unknown
length. While the rig goes straight ahead it does not matter; where it turns, cameras beside the
centre of the turn move differently, which tells it (`vo.engine.backend.rig_adjustment`).
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from vo.base.config import Config
from vo.base.failures import Failure, FailureReason
from vo.base.geometry.quantiles import median
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats
from vo.engine.frontend.frontend import Frontend
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.rig.frames import RigFrame
from vo.engine.tracking.monocular_initializer import MonocularInitializer

_WAITING = 60  # frames kept, one of which is the first of a pair
_MIN_SIGMAS = 3.0  # of a length of a metre, below which it is not known
_DRIFT = 0.01  # of the scale of a map, from window to window


class FirstPair(NamedTuple):
    """Two frames that make a map, the motion body_from_second_body (4, 4), and those between."""

    first: RigFrame
    second: RigFrame
    motion: Floats
    between: tuple[RigFrame, ...]


class RigStarter:
    """Waits for parallax in any of the views."""

    def __init__(
        self, local_map: LocalMap, mapper: LocalMapper, frontend: Frontend, config: Config
    ) -> None:
        self._parts = local_map, mapper, frontend, config.start, config.tracking.search_ratio
        self._initializers: list[MonocularInitializer] = []
        self._frames: deque[RigFrame] = deque(maxlen=_WAITING)

    def restart(self) -> None:
        """Forget the frames before."""
        self._initializers = []
        self._frames.clear()

    def attempt(self, frame: RigFrame, body_from_views: Floats) -> FirstPair | Failure:
        """A pair with this frame, whose usual depth is 1, or why there is none yet.

        `body_from_views`: (V, 4, 4), of which the rotations count.
        """
        if not self._initializers:
            self._initializers = [MonocularInitializer(*self._parts) for _ in frame.views]
        self._frames.append(frame)
        failure = Failure(FailureReason.REFERENCE_FRAME)
        best: FirstPair | None = None
        most = 0
        for view, initializer in enumerate(self._initializers):
            if not frame.used[view]:
                continue
            found = initializer.attempt(frame.views[view])
            if isinstance(found, Failure):
                failure = found
                continue
            before = [each for each in self._frames if each.index == found.reference.index]
            good = int(np.count_nonzero(found.two_view.good))
            if not before or good <= most:
                continue
            most, moved = good, inverse(found.two_view.second_from_first)
            moved[:3, 3] /= median(found.two_view.points[found.two_view.good, 2])
            turn = np.eye(4)
            turn[:3, :3] = body_from_views[view, :3, :3]
            between = [f for f in self._frames if before[0].index < f.index < frame.index]
            best = FirstPair(before[0], frame, turn @ moved @ inverse(turn), tuple(between))
        return failure if best is None else best


class Metre:
    """The length of a metre in a map without a scale, and how certain it is.

    Attributes:
        length: in units of the map; 1 where the scale is known by cameras that overlap.
        information: on that length.
        is_known: whether the map is in metres.
    """

    def __init__(self) -> None:
        self.restart(is_known=True)

    def restart(self, *, is_known: bool) -> None:
        """Begin with a map that is in metres, or in which nothing is known of them."""
        self.is_known = is_known
        self.length = 1.0 if is_known else 0.0
        self.information = 0.0

    def update(self, change: float, information: float, overlap: int) -> None:
        """Take in a window, of which each instant is in `overlap` ones."""
        self.length += change
        if self.information > 0.0:
            drift = (_DRIFT * self.length) ** 2
            self.information = 1.0 / (1.0 / self.information + drift)
        self.information += information / overlap

    @property
    def relative_sigma(self) -> float:
        """Standard deviation relative to the length; infinite while it is unknown."""
        if self.information <= 0.0 or self.length * np.sqrt(self.information) < _MIN_SIGMAS:
            return float("inf")
        return float(1.0 / (self.length * np.sqrt(self.information)))
