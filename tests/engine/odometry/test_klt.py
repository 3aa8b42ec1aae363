"""Optical flow (KLT) as the front end of the odometry."""

from __future__ import annotations

import pytest
from recorded_walk import Recording, aligned, track

from vo.base.config import load_config
from vo.base.faults import FaultKind

SETTINGS = ["tracking.method=klt", "threads=1"]


@pytest.mark.parametrize("detector", ["shi_tomasi", "fast", "orb"])
@pytest.mark.parametrize("cameras", [1, 2])
def test_the_walk_is_tracked(cameras: int, detector: str, recording: Recording) -> None:
    config = load_config("default", [*SETTINGS, f"features.detector={detector}"])
    rig = recording.rig if cameras == 2 else recording.mono_rig
    frames = recording.frames if cameras == 2 else recording.mono()
    run = track(rig, frames, config)
    missing = sum(e.world_from_cam0 is None for e in run.estimates)
    assert missing <= (0 if cameras == 2 else 6)
    assert not any(f.kind is FaultKind.TWO_MOTIONS for e in run.estimates for f in e.faults)
    rmse_m, _ = aligned(run, recording, with_scale=cameras == 1)
    assert rmse_m < 0.02
