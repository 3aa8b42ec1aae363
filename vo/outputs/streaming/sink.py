"""Interface of the outputs that receive each pose as soon as it is known."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from vo.base.types import Estimate


class PoseUpdate(NamedTuple):
    """A frame that was just tracked."""

    estimate: Estimate
    record: bytes  # the same as JSON (docs/outputs.md), a single line without its end
    # whether the source goes on while an output waits, which must not wait then
    is_live: bool = False


class PoseSink(Protocol):
    """Receives the poses of a run."""

    name: str  # what messages call it

    def send(self, update: PoseUpdate) -> None:
        """Send one frame.

        Raises:
            BrokenPipeError: the only reader is gone; the run ends as after Ctrl-C.
            OSError: nothing more can be sent; the run goes on without this output.
        """

    def close(self) -> None:
        """After the last frame, however the run ended; must not wait long."""
