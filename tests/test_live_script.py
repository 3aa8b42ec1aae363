"""How `scripts/live` judges a run."""

from __future__ import annotations

import time

import pytest
from live_run import Consumer, Phase, Sample, judged

from vo.base.types import Estimate, State

TOLD = ["90 images of the camera dropped (10%)"]


def phases(memory_mb: float = 300.0, dropped: int = 90, delay_ms: float = 20.0) -> list[Phase]:
    """A run that is as it should be, but for the arguments."""
    return [
        Phase("before", [Sample(1.0, 20.0, 0, 300.0)], 0),
        Phase("slow", [Sample(70.0, 230.0, dropped, 300.0)], dropped),
        Phase("after", [Sample(100.0, delay_ms, dropped, memory_mb)], 0),
    ]


def test_a_run_that_drops_tells_and_catches_up_is_good() -> None:
    assert judged(phases(), 90, TOLD) == []


@pytest.mark.parametrize(
    ("run", "dropped", "warnings", "problem"),
    [
        (phases(memory_mb=400.0), 90, TOLD, "memory has grown by 33%"),
        (phases(dropped=0), 0, [], "no image was dropped while the consumer was slow"),
        (phases(), 90, [], "dropped images were not reported"),
        (phases(delay_ms=2000.0), 90, TOLD, "after: poses come 2.0 s late"),
    ],
)
def test_each_target_can_be_missed(
    run: list[Phase], dropped: int, warnings: list[str], problem: str
) -> None:
    assert judged(run, dropped, warnings) == [problem]


def test_the_consumer_divides_a_run_into_phases(monkeypatch: pytest.MonkeyPatch) -> None:
    consumer = Consumer((2.0, 3.0))
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now)
    slept: list[float] = []
    monkeypatch.setattr(time, "sleep", slept.append)
    for number in range(10):
        monkeypatch.setattr(time, "time", lambda at=now + 0.5 * number: at)
        stamp_ns = int(1e9 * (now + 0.5 * number - 0.1))
        consumer.step(
            number,
            Estimate(
                number, stamp_ns, State.TRACKING, None, 0, None, False, 0, 0, 0, (), dropped=number
            ),
        )
    found = consumer.phases()
    assert [(phase.name, len(phase.samples), phase.dropped) for phase in found] == [
        ("before", 4, 3),
        ("slow", 2, 2),
        ("after", 4, 4),
    ]
    assert len(slept) == 2
    assert found[0].samples[0].delay_ms == pytest.approx(100.0, abs=0.01)
    assert found[1].line().startswith("| slow | 2 | 2 | 100 |")
