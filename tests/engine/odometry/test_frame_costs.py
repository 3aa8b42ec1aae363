"""What a frame costs, in counts that do not depend on the machine; times are for scripts/costs."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from recorded_walk import COUNT, Recording, track

from vo.base.compiling.function import Compiled

# Calls a frame, a tenth above what was counted. Whoever exceeds them says for what.
MAX_COMPILED, MAX_PYTHON, MAX_C = 39, 1290, 1250


def test_calls_of_a_stereo_frame(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    track(recording.rig, recording.frames)  # loads the machine code
    with counted_calls(monkeypatch) as calls:
        track(recording.rig, recording.frames)

    a_frame = {kind: count / COUNT for kind, count in calls.items()}
    assert a_frame["compiled"] <= MAX_COMPILED
    assert a_frame["call"] <= MAX_PYTHON
    assert a_frame["c_call"] <= MAX_C


@contextmanager
def counted_calls(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[str]]:
    """Calls of compiled functions by all threads, of Python and C functions by this one."""
    calls: Counter[str] = Counter()
    compiled: list[None] = []
    call = Compiled.__call__

    def counted(self: Compiled[Any, Any], *arguments: Any, **named: Any) -> Any:
        compiled.append(None)
        return call(self, *arguments, **named)

    def note(frame: object, event: str, argument: object) -> None:
        calls[event] += 1

    with monkeypatch.context() as patch:
        patch.setattr(Compiled, "__call__", counted)
        sys.setprofile(note)
        try:
            yield calls
        finally:
            sys.setprofile(None)
    calls["compiled"] = len(compiled)
