"""Decision whether a frame of a rig becomes a keyframe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vo.base.config import Config
from vo.base.geometry.quantiles import median
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.rig.frames import RigFrame
from vo.engine.rig.tracked import RigTracked
from vo.engine.tracking.keyframe_policy import Change, KeyframePolicy, median_parallax

_MIN_OBSERVATIONS = 10  # of a view whose parallax counts


class RigKeyframePolicy:
    """That of a pair, with the landmarks of all views, counted as if there were two."""

    def __init__(self, config: Config, views: int) -> None:
        self._policy = KeyframePolicy(config.keyframes, config.tracking.max_landmarks)
        self._ratio = 2.0 / views

    def needs_keyframe(
        self, local_map: LocalMap, last: Sequence[Keyframe], frame: RigFrame, tracked: RigTracked
    ) -> bool:
        """Whether a tracked frame should become a keyframe after the last instant's."""
        parallax = []
        for before, view in zip(last, tracked.views, strict=True):
            rows = view.observed.rows[view.inlier]
            if len(rows) >= _MIN_OBSERVATIONS:
                centres = before.world_from_cam[:3, 3], view.world_from_cam[:3, 3]
                parallax.append(median_parallax(local_map.xyz[rows], *centres))
        used = np.array(frame.used)
        counts = np.array([len(k.landmark) for k in last])
        change = Change(
            round(self._ratio * tracked.inliers),
            round(self._ratio * float(counts[used].sum())),
            median(np.array(parallax)) if parallax else 0.0,
            1e-9 * (frame.stamp_ns - last[0].frame.stamp_ns),
        )
        return self._policy.needs_keyframe(change)
