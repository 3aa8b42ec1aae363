"""Garbage collection is paused while modules are loaded, and works afterwards."""

from __future__ import annotations

import gc

import pytest

from vo.cli.garbage import collection_paused


def test_garbage_collection_is_paused_only_inside() -> None:
    with collection_paused():
        assert not gc.isenabled()
    assert gc.isenabled()


def test_garbage_collection_is_resumed_after_ctrl_c() -> None:
    with pytest.raises(KeyboardInterrupt), collection_paused():
        raise KeyboardInterrupt
    assert gc.isenabled()


def test_garbage_is_collected_afterwards() -> None:
    with collection_paused():
        pass
    loop: list[object] = []
    loop.append(loop)
    del loop
    assert gc.collect() >= 1
