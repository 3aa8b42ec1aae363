"""While modules are loaded no garbage is looked for; afterwards it is, whatever happened."""

from __future__ import annotations

import gc

import pytest

from vo.cli.loading import loading


def test_garbage_is_left_alone_while_modules_are_loaded_only() -> None:
    with loading():
        assert not gc.isenabled()
    assert gc.isenabled()


def test_ctrl_c_while_modules_are_loaded_leaves_it_on() -> None:
    with pytest.raises(KeyboardInterrupt), loading():
        raise KeyboardInterrupt
    assert gc.isenabled()


def test_what_is_thrown_away_afterwards_is_found() -> None:
    with loading():
        pass
    loop: list[object] = []
    loop.append(loop)
    del loop
    assert gc.collect() >= 1
