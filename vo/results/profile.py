"""Where the time of a run went, from its start to its end, with nothing left out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Profile(NamedTuple):
    """Wall time of the main thread.

    Attributes:
        wall_ms: all of it.
        stages_ms: by stage, together `wall_ms`; what belongs to none is `other`.
    """

    wall_ms: float
    stages_ms: Mapping[str, float]


def make_profile(wall_ms: float, stages_ms: Mapping[str, float]) -> Profile:
    """Round to microseconds, and name what no stage accounts for."""
    rounded = {stage: round(spent, 3) for stage, spent in stages_ms.items()}
    wall_ms = round(wall_ms, 3)
    return Profile(wall_ms, {**rounded, "other": round(wall_ms - sum(rounded.values()), 3)})
