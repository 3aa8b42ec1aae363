"""Forecast whether the next frame becomes a keyframe, whose features are then extracted early."""

from __future__ import annotations

from vo.engine.tracking.keyframe_policy import Change, KeyframePolicy

_WEIGHT = 0.25  # of the newest keyframe in the running average
_LIKELY = 0.6  # ratio of keyframes right after a keyframe from which another one is expected
_ALMOST_SURE = 0.85  # ratio from which even the frame after the next is expected to be one
_NO_CHANGE = Change(0, 0, 0.0, 0.0)


class KeyframeForecast:
    """Extrapolates the change since the last keyframe; a wrong forecast costs time only."""

    def __init__(self, policy: KeyframePolicy) -> None:
        self._policy = policy
        self._frames = 0  # since the last keyframe
        self._before = _NO_CHANGE  # of the frame before
        self._second_loss = 0.0  # ratio of the landmarks lost from the first frame to the second
        self._consecutive = 0.5  # ratio of keyframes that follow a keyframe immediately

    @property
    def expects_all(self) -> bool:
        """Whether almost every frame becomes a keyframe."""
        return self._consecutive > _ALMOST_SURE

    def expects_next(self, change: Change, *, is_keyframe: bool) -> bool:
        """Whether the next frame is likely to become a keyframe, after one with this change."""
        self._frames += 1
        before, self._before = self._before, change
        loss = before.tracked - change.tracked
        if self._frames == 1:  # many are lost at once, then fewer: use the keyframe before
            loss = round(self._second_loss * change.last_tracked)
        elif self._frames == 2:
            self._second_loss = loss / max(change.last_tracked, 1)
        if is_keyframe:
            self._consecutive += _WEIGHT * ((self._frames == 1) - self._consecutive)
            self._frames, self._before = 0, _NO_CHANGE
            return self._consecutive > _LIKELY
        extrapolated = Change(
            change.tracked - loss,
            change.last_tracked,
            2.0 * change.parallax_rad - before.parallax_rad,
            2.0 * change.elapsed_s - before.elapsed_s,
        )
        return self._policy.needs_keyframe(extrapolated)
