"""Decision on giving up a map in which frames are lost."""

from __future__ import annotations

from collections.abc import Sequence

from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.inertial.prediction import InertialPredictor

_MAX_PREDICTED_S = 1.5  # lost frames that an inertial sensor predicts


class LossPolicy:
    """Gives up after a number of lost frames; later while an inertial sensor predicts the pose.

    Args:
        recover_frames: lost frames that are searched in the map.
        predictor: predicts, None without a sensor.
    """

    def __init__(self, recover_frames: int, predictor: InertialPredictor | None) -> None:
        self._recover_frames = recover_frames
        self._predictor = predictor

    def gives_up(self, lost: Sequence[PreprocessedFrame]) -> bool:
        """Whether to give up the map after these lost frames."""
        if len(lost) <= self._recover_frames:
            return False
        first_ns, last_ns = lost[0].stamp_ns, lost[-1].stamp_ns
        if self._predictor is None or last_ns - first_ns >= _MAX_PREDICTED_S * 1e9:
            return True
        return not self._predictor.has_samples(first_ns, last_ns)
