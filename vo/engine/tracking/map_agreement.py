"""How much of the map each frame confirms: a sign of a second motion in the image.

A large thing that moves through the image hides the map, or takes its landmarks along. A pose is
still found, from the minority that agrees, and whose motion it is remains uncertain.
"""

from __future__ import annotations

from vo.base.faults import Fault, FaultKind
from vo.engine.mapping.tracked_frame import TrackedFrame

_FRAMES = 5  # consecutive ones, since a blurred or dark frame confirms little as well


class MapAgreement:
    """Counts consecutive frames in which little of the map agrees with the pose."""

    def __init__(self) -> None:
        self._few = 0
        self._disagreeing = 0

    def restart(self) -> None:
        """Begin at a new map."""
        self._few = self._disagreeing = 0

    def update(self, tracked: TrackedFrame) -> tuple[Fault, ...]:
        """Faults of the next tracked frame."""
        self._few = self._few + 1 if tracked.is_hardly_confirmed else 0
        self._disagreeing = self._disagreeing + 1 if tracked.is_contradicted else 0
        if max(self._few, self._disagreeing) < _FRAMES:
            return ()
        return (Fault(FaultKind.TWO_MOTIONS, value=1.0 - tracked.inlier_ratio),)
