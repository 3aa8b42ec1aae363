"""Faults of a run, collected by kind."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from vo.base.faults import Fault, FaultKind

# Found by tracking, and not in the images alone.
_OF_TRACKING = (
    FaultKind.TWO_MOTIONS,
    FaultKind.IMPLAUSIBLE_STEP,
    FaultKind.WRONG_STEREO_CALIBRATION,
    FaultKind.WRONG_LENS,
)


class FaultRecord(NamedTuple):
    """All faults of one kind in a run."""

    kind: FaultKind
    is_handled: bool  # whether all of them were handled, see `Fault`
    frames: int  # number of frames with it; 0 for a fault of the whole recording
    first: int | None  # number of the first frame with it, None for a fault of the whole recording
    last: int | None  # number of the last frame with it, or None
    value: float  # of the largest magnitude, in the unit of its message
    place: str = ""  # where the one of this value lies in the image; empty if that does not apply

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**self._asdict(), "kind": self.kind.value, "value": round(self.value, 4)}


class FaultLog:
    """Collects faults; its size does not depend on the length of a run."""

    def __init__(self) -> None:
        self._records: dict[FaultKind, FaultRecord] = {}

    def add(self, faults: Iterable[Fault], frame: int | None = None) -> None:
        """Add the faults of a frame, or those of the whole recording."""
        for fault in faults:
            before = self._records.get(fault.kind)
            count = 0 if frame is None else 1
            record = FaultRecord(
                fault.kind, fault.is_handled, count, frame, frame, fault.value, fault.place
            )
            self._records[fault.kind] = record if before is None else _joined(before, record)

    def withdraw_from(self, frame: int) -> None:
        """Remove what tracking has found from a frame on, which has been tracked anew."""
        for kind in _OF_TRACKING:
            record = self._records.get(kind)
            if record is not None and record.first is not None and record.first >= frame:
                del self._records[kind]

    def records(self) -> tuple[FaultRecord, ...]:
        """One record for each kind, in the order of `FaultKind`."""
        return tuple(self._records[kind] for kind in FaultKind if kind in self._records)


def _joined(before: FaultRecord, new: FaultRecord) -> FaultRecord:
    larger = max(before, new, key=lambda record: abs(record.value))
    return FaultRecord(
        before.kind,
        before.is_handled and new.is_handled,
        before.frames + new.frames,
        new.first if before.first is None else before.first,
        before.last if new.last is None else new.last,
        larger.value,
        larger.place,
    )
