"""Predicted poses in the causal path of a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vo.base.types import Trajectory
from vo.outputs.evaluation.association import predicted, tracked_part

HEADING = "frame,stamp_ns,state"
ROWS = ("0,100,starting", "1,200,tracking", "2,300,lost", "3,400,tracking")
CAUSAL = Trajectory(np.array([200, 300, 400]), np.tile(np.eye(4), (3, 1, 1)))


@pytest.mark.parametrize("name", ["frames.csv", "frames.csv.partial"])
def test_poses_of_lost_frames_are_left_out(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("\n".join([HEADING, *ROWS]) + "\n")
    assert predicted(CAUSAL, tmp_path).tolist() == [False, True, False]
    assert tracked_part(CAUSAL, tmp_path).stamps_ns.tolist() == [200, 400]


@pytest.mark.parametrize("text", [None, "", "frame\n1\n", "stamp_ns,state\nx,lost\n", "\0"])
def test_all_are_kept_without_a_usable_table(text: str | None, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "frames.csv").write_text(text)
    assert len(tracked_part(CAUSAL, tmp_path)) == 3
