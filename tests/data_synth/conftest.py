from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from data_synth.room import make_room
from data_synth.world import World


@pytest.fixture(scope="session")
def room() -> World:
    return make_room(seed=0)


@pytest.fixture(scope="session")
def pool() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor() as threads:
        yield threads
