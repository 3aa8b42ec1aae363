"""Wall time by stage."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from vo.base.stopwatch import Stopwatch, timed


class Clock:
    """A clock that is set by hand, in seconds."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def wait_ms(self, milliseconds: float) -> None:
        self.now_s += milliseconds * 1e-3


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    fake_time = SimpleNamespace(perf_counter=lambda: clock.now_s)
    monkeypatch.setattr("vo.base.stopwatch.time", fake_time)
    return clock


def test_each_stage_is_counted_and_repeated_ones_are_added() -> None:
    stopwatch = Stopwatch()
    for name in ("match", "align", "match"):
        before = stopwatch.stage_ms.get(name, 0.0)
        with stopwatch.stage(name):
            sum(range(1000))
        assert stopwatch.stage_ms[name] > before
    assert list(stopwatch.stage_ms) == ["match", "align"]


def test_a_stage_that_fails_is_counted_too(clock: Clock) -> None:
    stopwatch = Stopwatch()
    with pytest.raises(KeyError), stopwatch.stage("map"):
        clock.wait_ms(2.0)
        raise KeyError
    clock.wait_ms(50.0)  # outside of any stage
    assert stopwatch.take() == pytest.approx({"map": 2.0})


def test_a_nested_stage_pauses_the_outer_one(clock: Clock) -> None:
    stopwatch = Stopwatch()
    with stopwatch.stage("window"):
        clock.wait_ms(1.0)
        with stopwatch.stage("smooth"):
            clock.wait_ms(10.0)
            with stopwatch.stage("window"):
                clock.wait_ms(2.0)
            clock.wait_ms(20.0)
        clock.wait_ms(4.0)
    clock.wait_ms(50.0)
    assert stopwatch.take() == pytest.approx({"window": 7.0, "smooth": 30.0})


def test_taking_the_times_empties_the_stopwatch(clock: Clock) -> None:
    stopwatch = Stopwatch()
    with stopwatch.stage("match"):
        clock.wait_ms(3.0)
    assert stopwatch.take() == pytest.approx({"match": 3.0})
    assert stopwatch.take() == {}
    with stopwatch.stage("align"):
        clock.wait_ms(5.0)
    assert stopwatch.take() == pytest.approx({"align": 5.0})


def test_a_running_stage_is_taken_in_parts(clock: Clock) -> None:
    stopwatch = Stopwatch()
    with stopwatch.stage("smooth"):
        clock.wait_ms(3.0)
        assert stopwatch.take() == pytest.approx({"smooth": 3.0})
        clock.wait_ms(4.0)
    assert stopwatch.take() == pytest.approx({"smooth": 4.0})


class Worker:
    """An object whose methods are timed."""

    def __init__(self, clock: Clock) -> None:
        self.stopwatch = Stopwatch()
        self._clock = clock

    @timed("outer")
    def work(self, ms: float, *, inner_ms: float) -> float:
        """Work for some time."""
        self._clock.wait_ms(ms)
        self.rest(inner_ms)
        return ms + inner_ms

    @timed("inner")
    def rest(self, ms: float) -> None:
        self._clock.wait_ms(ms)


def test_timed_methods_count_towards_their_stages_and_are_otherwise_the_same(clock: Clock) -> None:
    worker = Worker(clock)
    assert worker.work(2.0, inner_ms=5.0) == 7.0
    assert worker.stopwatch.take() == pytest.approx({"outer": 2.0, "inner": 5.0})
    assert Worker.work.__doc__ == "Work for some time."
