"""Decision whether a frame of a rig becomes a keyframe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vo.base.config import Config
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.rig.frames import RigFrame
from vo.engine.rig.tracked import RigTracked, landmarks_per_view
from vo.engine.tracking.keyframe_policy import Change, KeyframePolicy, median_parallax

_MIN_OBSERVATIONS = 10  # of a view whose parallax counts
# Quantile of the parallax of views that counts. Of several views some always lose much: relative to
# what a pair may lose. The second ones while a camera is left out: then views that keep their
# landmarks, to the rear, must not keep those ahead waiting for new ones, which give the scale.
_PARALLAX_QUANTILE, _LOST_RATIO = (0.25, 0.75), (0.8, 1.0)


class RigKeyframePolicy:
    """That of a pair, with the landmarks of all views.

    Views to the sides soon see another side of what is near; where landmarks stay in view that
    alone needs no keyframe, so that the parallax of views that change less decides.
    """

    def __init__(self, config: Config, views: int) -> None:
        most = config.tracking.max_landmarks
        self._policy = KeyframePolicy(config.keyframes, most)
        self._ratio = most / (views * landmarks_per_view(most, views))

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
        used, lacks = np.array(frame.used), int(not all(frame.used))
        counts = np.array([len(k.landmark) for k in last])
        change = Change(
            round(self._ratio * tracked.inliers),
            round(self._ratio * _LOST_RATIO[lacks] * float(counts[used].sum())),
            float(np.quantile(parallax, _PARALLAX_QUANTILE[lacks])) if parallax else 0.0,
            1e-9 * (frame.stamp_ns - last[0].frame.stamp_ns),
        )
        return self._policy.needs_keyframe(change)
