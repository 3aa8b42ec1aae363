"""A larger chunk of memory for the frames of calls changes nothing else."""

from __future__ import annotations

import sys

import pytest

from vo.cli.frame_stack import with_room


def test_the_function_runs_once_and_its_errors_pass() -> None:
    calls = []

    def function() -> None:
        calls.append(sys._getframe().f_code.co_name)
        raise ValueError("as it was")

    with pytest.raises(ValueError, match="as it was"):
        with_room(function)()
    assert calls == ["function"]


def test_its_frame_takes_more_than_a_quarter_of_a_megabyte() -> None:
    def function() -> None:
        assert 8 * sys._getframe().f_code.co_stacksize > 2**18

    with_room(function)()
