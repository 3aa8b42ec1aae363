"""Whether the next frame is likely to become a keyframe: then its features are looked for early."""

from __future__ import annotations

from vo.config import KeyframeConfig
from vo.tracking.keyframe_policy import Change, needs_keyframe

_NEWEST = 0.25  # weight of the newest of the cases that a share is about
_LIKELY = 0.6  # share of keyframes right after one from which on another is expected there
_ALMOST_SURE = 0.85  # and from which on even the frame after the next is expected to be one
_NOTHING = Change(0, 0, 0.0, 0.0)


class KeyframeForecast:
    """Expects what changes from a keyframe on to go on as it did; errors cost time only."""

    def __init__(self, config: KeyframeConfig) -> None:
        self._config = config
        self._frames = 0  # since the last keyframe
        self._before = _NOTHING  # what had changed in the last of them
        self._second_loss = 0.0  # share of the landmarks lost from the first to the second
        self._again = 0.5  # share of keyframes that come right after one

    @property
    def expects_all(self) -> bool:
        """Whether almost every frame becomes a keyframe."""
        return self._again > _ALMOST_SURE

    def expects(self, change: Change, *, is_keyframe: bool) -> bool:
        """Whether the frame after one that has changed so much is likely to become a keyframe."""
        self._frames += 1
        before, self._before = self._before, change
        loss = before.tracked - change.tracked
        if self._frames == 1:  # many are lost at once, then fewer: go by the keyframe before
            loss = round(self._second_loss * change.last_tracked)
        elif self._frames == 2:
            self._second_loss = loss / max(change.last_tracked, 1)
        if is_keyframe:
            self._again += _NEWEST * ((self._frames == 1) - self._again)
            self._frames, self._before = 0, _NOTHING
            return self._again > _LIKELY
        coming = Change(
            change.tracked - loss,
            change.last_tracked,
            2.0 * change.parallax_rad - before.parallax_rad,
            2.0 * change.elapsed_s - before.elapsed_s,
        )
        return needs_keyframe(coming, self._config)
