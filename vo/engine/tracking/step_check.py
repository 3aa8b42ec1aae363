"""Check of steps: whether the motion of the frames before and after supports a frame's pose.

A pose on which a minority of the landmarks agrees may be wrong, as where flicker or snow changes
what patches look like, or a moving thing fills the image. Cameras have mass: their acceleration
stays within a small multiple of the usual one. A step that needs many times as much, and is
confirmed by fewer landmarks than usual, is implausible, unless the next frame confirms it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from vo.base.failures import Failure, FailureReason
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.quantiles import median
from vo.base.types import Floats
from vo.engine.mapping.tracked_frame import TrackedFrame

_HISTORY, _MIN_HISTORY = 20, 5  # steps
# Maximum acceleration in units of the usual one. Handheld, driving and flying recordings have up to
# 6; wrong poses 15 to 120.
_MAX_EXCESS = 12.0
# Minimum of the usual acceleration: m/s² with a known scale; else the highest speed so far in 4 s.
_MIN_USUAL_M_S2, _MIN_USUAL_PER_S = 1.0, 0.25
# Ratios of confirmed landmarks from which a step is believed however fast it is: of all in view,
# and of the usual ratio; and of the usual ratio where the next frame goes on from there.
_MANY, _AS_MANY_AS_USUAL, _FEWER = 0.6, 0.9, 0.7
_MAX_SPEED_M_S = 300.0  # about that of sound


class _Rejected(NamedTuple):
    """A pose that was not accepted, which the next frame may confirm."""

    stamp_ns: int
    position: Floats
    inlier_ratio: float


class Step(NamedTuple):
    """A step to be checked.

    Attributes:
        stamp_ns: time of the frame.
        last: (4, 4) world_from_cam of the last tracked frame.
        predicted: (4, 4) of the frame, by the motion before.
        pose: (4, 4) of the frame, as tracked.
        inlier_ratio: of the landmarks in view, that agree with it.
    """

    stamp_ns: int
    last: Floats
    predicted: Floats
    pose: Floats
    inlier_ratio: float


class StepCheck:
    """Compares steps with those before; remembers a pose that it has rejected."""

    def __init__(self, *, is_metric: bool) -> None:
        self._is_metric = is_metric
        self.restart(0)

    def restart(self, stamp_ns: int) -> None:
        """Begin at the first frame of a segment."""
        self._stamp_ns, self._interval_s = stamp_ns, 0.0
        self._accelerations: deque[float] = deque(maxlen=_HISTORY)
        self._ratios: deque[float] = deque(maxlen=_HISTORY)
        self._max_speed = 0.0
        self._rejected: _Rejected | None = None

    @property
    def knows_motion(self) -> bool:
        """Whether enough steps are known to judge the next one."""
        return len(self._accelerations) >= _MIN_HISTORY

    def update(self, step: Step) -> None:
        """Add an accepted step."""
        interval_s = (step.stamp_ns - self._stamp_ns) * 1e-9
        if interval_s > 0:
            if self._interval_s > 0:
                self._accelerations.append(self._acceleration(step))
            speed = _distance(step.last, step.pose) / interval_s
            self._max_speed = max(self._max_speed, speed)
        self._ratios.append(step.inlier_ratio)
        self._stamp_ns, self._interval_s, self._rejected = step.stamp_ns, interval_s, None

    def failure(self, step: Step) -> Failure | None:
        """Why a step is implausible; None if it may be right."""
        interval_s = (step.stamp_ns - self._stamp_ns) * 1e-9
        if interval_s <= 0:
            return None
        speed = _distance(step.last, step.pose) / interval_s
        if self._is_metric and speed > _MAX_SPEED_M_S:
            return Failure(FailureReason.IMPLAUSIBLE_SPEED, speed, _MAX_SPEED_M_S)
        if not self.knows_motion:
            return None
        excess = self._acceleration(step) / self._usual()
        if excess < _MAX_EXCESS:
            return None
        if self._is_well_supported(step.inlier_ratio) or self._is_confirming(step):
            return None
        return Failure(FailureReason.IMPLAUSIBLE_STEP, excess, _MAX_EXCESS)

    def reject(self, step: Step) -> None:
        """Remember a pose that was not accepted."""
        position = step.pose[:3, 3]
        self._rejected = _Rejected(step.stamp_ns, position, step.inlier_ratio)

    def _usual(self) -> float:
        fewest = _MIN_USUAL_M_S2 if self._is_metric else _MIN_USUAL_PER_S * self._max_speed
        return max(_median(self._accelerations), fewest, 1e-12)

    def _acceleration(self, step: Step) -> float:
        """Of the mean velocities before and after the last frame, of lengths h' and h.

        The prediction errs by a h (h + h') / 2 at a constant acceleration a.
        """
        interval_s = (step.stamp_ns - self._stamp_ns) * 1e-9
        error = _distance(step.predicted, step.pose)
        return 2.0 * error / (interval_s * (interval_s + (self._interval_s or interval_s)))

    def _is_well_supported(self, ratio: float) -> bool:
        return ratio >= _MANY and ratio >= _AS_MANY_AS_USUAL * _median(self._ratios)

    def _is_confirming(self, step: Step) -> bool:
        """Whether the camera goes on from the pose rejected before, with any velocity known."""
        before = self._rejected
        if before is None or step.stamp_ns <= before.stamp_ns:
            return False
        fewest = _FEWER * _median(self._ratios)
        if min(before.inlier_ratio, step.inlier_ratio) < fewest:
            return False
        last, interval_s = step.last[:3, 3], (step.stamp_ns - before.stamp_ns) * 1e-9
        old = (step.predicted[:3, 3] - last) / ((step.stamp_ns - self._stamp_ns) * 1e-9)
        new = (before.position - last) / ((before.stamp_ns - self._stamp_ns) * 1e-9)
        moved = step.pose[:3, 3] - before.position
        error = min(float(np.linalg.norm(moved - v * interval_s)) for v in (old, new))
        return error / interval_s**2 < _MAX_EXCESS * self._usual()


def _median(few: Iterable[float]) -> float:
    """As `median`, of plain numbers without NaN, in a tenth of the time."""
    ranked = sorted(few)
    last = len(ranked) - 1
    return 0.5 * (ranked[last // 2] + ranked[(last + 1) // 2])


def _distance(a: Floats, b: Floats) -> float:
    return math.dist(a[:3, 3].tolist(), b[:3, 3].tolist())


_FEW_FRAMES = 5  # consecutive ones, since a blurred or dark frame confirms little as well
# Medians over the newest frames of the ratio of landmarks in view that agree, and of how well their
# patches correlate. Under a weak net of moving light: 0.33 and 0.92; clean recordings have at least
# 0.50, those in the dark as well, whose patches correlate by 0.86; turns of a blurred camera 0.33,
# with 0.95.
_NEWEST, _MIN_AGREEING, _MIN_CORRELATION = 30, 0.45, 0.94
# Median over the newest frames of the ratio of the landmarks found that agree, in units of its mean
# so far: where turns of 300°/s have bent the map of one camera at most 0.87, elsewhere at least
# 0.93, and real drives with a distorted lens, which have 0.82 themselves, as well.
_NEWEST_FOUND, _MIN_RELATIVE = 10, 0.88


class MapAgreement:
    """Counts frames in which little of the map agrees with the pose.

    A sign of a second motion: a large thing that moves through the image hides the map, or takes
    its landmarks along. A pose is still found, from the minority that agrees, and whose motion it
    is remains uncertain. In many frames, with patches that look different: of moving light. In
    many frames of one camera, with landmarks that are found elsewhere: of a map that is bent.
    """

    def __init__(self, *, is_metric: bool) -> None:
        self._is_metric = is_metric
        self._newest: deque[tuple[float, float]] = deque(maxlen=_NEWEST)
        self._newest_found: deque[float] = deque(maxlen=_NEWEST_FOUND)
        self.restart()

    def restart(self) -> None:
        """Begin at a new map."""
        self._few = self._disagreeing = self._frames = 0
        self._sum_found = 0.0
        self._newest.clear()
        self._newest_found.clear()

    def update(self, tracked: TrackedFrame) -> tuple[Fault, ...]:
        """Faults of the next tracked frame."""
        self._few = self._few + 1 if tracked.is_hardly_confirmed else 0
        self._disagreeing = self._disagreeing + 1 if tracked.is_contradicted else 0
        ratio = tracked.inlier_ratio
        if max(self._few, self._disagreeing) >= _FEW_FRAMES:
            return (Fault(FaultKind.TWO_MOTIONS, value=1.0 - ratio),)
        if not self._is_metric and self._is_bent(tracked):
            return (Fault(FaultKind.BENT_MAP, value=1.0 - _median(self._newest_found)),)
        is_low = ratio < _MIN_AGREEING
        correlation = median(tracked.observed.score[tracked.inlier]) if is_low else 1.0
        self._newest.append((ratio, correlation))
        correlations = (correlation for _, correlation in self._newest)
        if len(self._newest) < _NEWEST or _median(correlations) > _MIN_CORRELATION:
            return ()
        agreeing = _median(ratio for ratio, _ in self._newest)
        return (Fault(FaultKind.CHANGING_APPEARANCE, value=1.0 - agreeing),)

    def _is_bent(self, tracked: TrackedFrame) -> bool:
        """Whether landmarks are found in other places than the map has them, and were not."""
        self._newest_found.append(tracked.inliers / max(len(tracked.observed), 1))
        self._sum_found += self._newest_found[-1]
        self._frames += 1
        usual = self._sum_found / self._frames
        newest = _median(self._newest_found)
        return self._frames >= _NEWEST and newest < _MIN_RELATIVE * usual
