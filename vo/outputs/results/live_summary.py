"""What a run on a live source dropped and missed, and how late its poses were."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.failures import Gap


class Delay(NamedTuple):
    """Time from the capture of an image to its pose, over all frames, in milliseconds."""

    median: float
    p95: float
    max: float


class LiveState(NamedTuple):
    """A live source as far as it has come; only runs on one have it in `summary.json`."""

    dropped: int  # images that were left out, because newer ones came before they could be tracked
    gaps: tuple[Gap, ...] = ()  # times without images, because the connection was lost
    # tracked frames that `--record` has left out; None without `--record`
    unrecorded: int | None = None
    delay_ms: Delay | None = None


def delay_of(delays_ms: Sequence[float]) -> Delay | None:
    """Summary of the delays of all frames; None without any."""
    if not delays_ms:
        return None
    median, p95, largest = np.percentile(delays_ms, (50, 95, 100))
    return Delay(round(float(median), 1), round(float(p95), 1), round(float(largest), 1))


def live_warnings(live: LiveState | None, frames: int) -> list[str]:
    """Warnings about images that were not tracked or not recorded."""
    if live is None:
        return []
    warnings = []
    if live.dropped:
        ratio = live.dropped / max(frames + live.dropped, 1)
        warnings.append(
            f"{live.dropped} images of the camera dropped ({ratio:.0%}): newer ones came before "
            "they could be tracked; `config=fast` needs less time"
        )
    if live.gaps:
        longest_s = max(1e-9 * (gap.last_ns - gap.first_ns) for gap in live.gaps)
        times = f"{len(live.gaps)} times" if len(live.gaps) > 1 else "once"
        warnings.append(
            f"connection lost {times}, for up to {longest_s:.1f} s; there are no poses in between"
        )
    if live.unrecorded:
        warnings.append(
            f"{live.unrecorded} tracked frames are missing in the file of `record`: the disk was "
            "too slow"
        )
    return warnings
