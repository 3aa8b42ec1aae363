from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vo
from vo.base.errors import ConfigError
from vo.runs.run_options import RunOptions


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"strides": 2}, "unknown option 'strides'; did you mean 'stride'?"),
        ({"start": "3"}, "the option start is '3', not a whole number"),
        ({"start": True}, "the option start is True, not a whole number"),
        ({"mode": "both"}, "the option mode is 'both', not one of 'auto', 'mono', 'stereo'"),
        ({"calibration": 7}, "the option calibration is 7, not a path or None"),
        ({"topics": "/left"}, "the option topics is '/left', not a list, each a text"),
        ({"recorder": "x.rrd"}, "the option recorder is 'x.rrd', not Recorder or None"),
        ({"exports": "x.ply"}, "the option exports is 'x.ply', not Exports or None"),
    ],
)
def test_a_wrong_option_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        vo.run("nowhere", "out", **given)
    assert str(caught.value) == message


def test_options_are_taken_as_they_are_given() -> None:
    options = RunOptions.of(
        {"calibration": "camera.yaml", "start": np.int64(3), "timeout_s": 2, "poses": ["-"]}
    )
    assert options.calibration == Path("camera.yaml")
    assert (options.start, options.timeout_s, options.poses) == (3, 2, ["-"])
    assert options.mode == "auto" and options.exports is None
