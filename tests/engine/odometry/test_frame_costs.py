"""What a frame costs, in counts that do not depend on the machine; times are for scripts/costs."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from numba.core.runtime._nrt_python import (
    memsys_disable_stats,
    memsys_enable_stats,
    memsys_get_stats_mi_alloc,
)
from recorded_walk import COUNT, Recording, track

from vo.base.compiling.function import Compiled

# Calls a frame, and arrays that compiled functions take or make, a tenth above what was counted.
# Whoever exceeds them says for what.
MAX_COMPILED, MAX_PYTHON, MAX_C, MAX_ARRAYS = 39, 1255, 1215, 505


def test_costs_of_a_stereo_frame(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    track(recording.rig, recording.frames)  # loads the machine code
    with counted_calls(monkeypatch) as calls:
        track(recording.rig, recording.frames)

    a_frame = {kind: count / COUNT for kind, count in calls.items()}
    assert a_frame["compiled"] <= MAX_COMPILED
    assert a_frame["call"] <= MAX_PYTHON
    assert a_frame["c_call"] <= MAX_C
    assert a_frame["array"] <= MAX_ARRAYS


@contextmanager
def counted_calls(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[str]]:
    """Calls and arrays of compiled functions in all threads, other calls in this one."""
    calls: Counter[str] = Counter()
    memsys_enable_stats()
    arrays = memsys_get_stats_mi_alloc()
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
            calls["array"] = memsys_get_stats_mi_alloc() - arrays
            memsys_disable_stats()
    calls["compiled"] = len(compiled)
