"""Wall time of a run by stage; the stages add up to the whole."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Profile(NamedTuple):
    """Wall time of the main thread."""

    wall_ms: float
    # by stage, adding up to `wall_ms`; time outside of all stages is `other`
    stages_ms: Mapping[str, float]


def make_profile(wall_ms: float, stages_ms: Mapping[str, float]) -> Profile:
    """Round to microseconds, and add the stage `other`."""
    rounded = {stage: round(spent, 3) for stage, spent in stages_ms.items()}
    wall_ms = round(wall_ms, 3)
    return Profile(wall_ms, {**rounded, "other": round(wall_ms - sum(rounded.values()), 3)})
