from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from data_synth.scene.world import World
from data_synth.worlds.room import make_scene


@pytest.fixture(scope="session")
def room() -> World:
    return make_scene(seed=0).world


@pytest.fixture(scope="session")
def pool() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor() as threads:
        yield threads
