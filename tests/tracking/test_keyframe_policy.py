"""Which tracked frames become keyframes, in a map as it is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vo.config import load_config
from vo.mapping.keyframes import change_since
from vo.tracking.keyframe_policy import needs_keyframe

CONFIG = load_config("fast")
MOST = CONFIG.tracking.max_landmarks


def _wants(seen_by_last: int, tracked: int) -> bool:
    """A camera that stands still, and how many landmarks it still tracks."""
    last = SimpleNamespace(
        landmark=np.arange(seen_by_last), world_from_cam=np.eye(4), stamp_ns=1_000_000_000
    )
    world: Any = SimpleNamespace(keyframes=[last], xyz=np.tile([0.0, 0.0, 5.0], (seen_by_last, 1)))
    observed = SimpleNamespace(rows=np.arange(tracked))
    placed: Any = SimpleNamespace(
        world_from_cam=np.eye(4), observed=observed, inlier=np.ones(tracked, dtype=bool)
    )
    frame: Any = SimpleNamespace(stamp_ns=1_050_000_000)
    return needs_keyframe(change_since(world, frame, placed, CONFIG), CONFIG.keyframes)


@pytest.mark.parametrize("seen_by_last", [MOST, 2 * MOST, 4 * MOST])
def test_a_still_camera_makes_none_however_rich_the_scene(seen_by_last: int) -> None:
    assert not _wants(seen_by_last, round(0.97 * MOST))


@pytest.mark.parametrize("seen_by_last", [round(0.8 * MOST), 2 * MOST])
def test_a_camera_that_has_lost_half_of_them_makes_one(seen_by_last: int) -> None:
    assert _wants(seen_by_last, round(0.4 * MOST))
