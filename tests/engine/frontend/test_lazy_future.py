"""Work that starts before it is needed."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from vo.engine.frontend.lazy_future import LazyFuture, each_started_early, finished


def _numbers() -> Iterator[int]:
    yield from (1, 2)
    raise OSError("the third cannot be read")


def test_what_was_read_before_an_error_still_counts() -> None:
    found = []
    with pytest.raises(OSError, match="the third"):
        for each in each_started_early(_numbers(), finished):
            found.append(each.result())
    assert found == [1, 2]


def test_it_may_be_closed_early() -> None:
    started: list[int] = []

    def submit(number: int) -> LazyFuture[int]:
        started.append(number)
        return finished(number)

    futures = each_started_early(iter(range(9)), submit)
    assert isinstance(futures, Iterator)
    assert next(futures).result() == 0
    futures.close()  # type: ignore[attr-defined]
    assert started == [0, 1]
    assert list(futures) == []
