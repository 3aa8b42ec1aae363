"""When a frame of a rig becomes a keyframe."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from vo.base.config import load_config
from vo.engine.rig.policy import RigKeyframePolicy

FAR, NEAR, BASELINE = 100.0, 1.5, 0.3


@pytest.mark.parametrize("is_covered", [False, True])
def test_views_to_the_rear_do_not_decide_while_a_camera_is_left_out(is_covered: bool) -> None:
    """Two views keep far landmarks, two see near ones, which move; a fifth may be covered."""
    depths = np.repeat([FAR, FAR, NEAR, NEAR], 50)
    local_map = SimpleNamespace(xyz=np.stack([0 * depths, 0 * depths, depths], axis=1))
    now = np.eye(4)
    now[0, 3] = BASELINE
    views = [
        SimpleNamespace(
            world_from_cam=now,
            observed=SimpleNamespace(rows=np.arange(50 * v, 50 * (v + 1))),
            inlier=np.ones(50, bool),
        )
        for v in range(4)
    ]
    last_frame = SimpleNamespace(stamp_ns=0)
    last = [
        SimpleNamespace(world_from_cam=np.eye(4), landmark=np.arange(50), frame=last_frame)
        for _ in range(4)
    ]
    frame = SimpleNamespace(stamp_ns=100_000_000, used=(True,) * 4 + (not is_covered,))
    nothing = SimpleNamespace(
        world_from_cam=now, observed=SimpleNamespace(rows=np.arange(0)), inlier=np.ones(0, bool)
    )
    last.append(SimpleNamespace(world_from_cam=np.eye(4), landmark=np.arange(0), frame=last_frame))
    tracked = SimpleNamespace(views=(*views, nothing), inliers=200)
    policy = RigKeyframePolicy(load_config(), 5)
    parts: Any = local_map, last, frame, tracked
    assert policy.needs_keyframe(*cast(Any, parts)) == is_covered
