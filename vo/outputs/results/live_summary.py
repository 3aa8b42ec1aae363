"""What a run on a live source dropped and missed, and how late its poses were."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from vo.base.failures import Gap


class LiveState(NamedTuple):
    """A live source as far as it has come."""

    dropped: int  # images that were left out, because newer ones came before they could be tracked
    gaps: tuple[Gap, ...] = ()  # times without images, because the connection was lost
    # tracked frames that `--record` has left out; None without `--record`
    unrecorded: int | None = None


class Delay(NamedTuple):
    """Time from the capture of an image to its pose, over all frames, in milliseconds."""

    median: float
    p95: float
    max: float


class LiveSummary(NamedTuple):
    """The part of `summary.json` that only runs on live sources have."""

    state: LiveState
    delay_ms: Delay | None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            **self.state._asdict(),
            "gaps": [gap._asdict() for gap in self.state.gaps],
            "delay_ms": None if self.delay_ms is None else self.delay_ms._asdict(),
        }


def delay_of(delays_ms: Sequence[float]) -> Delay | None:
    """Summary of the delays of all frames; None without any."""
    if not delays_ms:
        return None
    median, p95, largest = np.percentile(delays_ms, (50, 95, 100))
    return Delay(round(float(median), 1), round(float(p95), 1), round(float(largest), 1))


def live_warnings(live: LiveSummary | None, frames: int) -> list[str]:
    """Warnings about images that were not tracked or not recorded."""
    if live is None:
        return []
    state, warnings = live.state, []
    if state.dropped:
        ratio = state.dropped / max(frames + state.dropped, 1)
        warnings.append(
            f"{state.dropped} images of the camera dropped ({ratio:.0%}): newer ones came before "
            "they could be tracked; `config=fast` needs less time"
        )
    if state.gaps:
        longest_s = max(1e-9 * (gap.last_ns - gap.first_ns) for gap in state.gaps)
        times = f"{len(state.gaps)} times" if len(state.gaps) > 1 else "once"
        warnings.append(
            f"connection lost {times}, for up to {longest_s:.1f} s; there are no poses in between"
        )
    if state.unrecorded:
        warnings.append(
            f"{state.unrecorded} tracked frames are missing in the file of `record`: the disk was "
            "too slow"
        )
    return warnings
