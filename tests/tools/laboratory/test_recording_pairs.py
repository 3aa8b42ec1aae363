"""Pairs of frames with known motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import vo
from vo.base.errors import SourceError
from vo.base.geometry.transforms import inverse
from vo.base.types import Trajectory
from vo.recordings.formats.trajectory import read_tum
from vo.tools.laboratory.comparison import plan_pairs


def test_motions_are_those_of_the_frames(
    synthetic_stereo: Path, caplog: pytest.LogCaptureFixture
) -> None:
    poses = read_tum(synthetic_stereo / "groundtruth.tum").world_from_cam
    planned = plan_pairs(vo.open(synthetic_stereo, mode="mono"), [1, 20, 40], 2)
    assert planned.frames == ((1, 7), (1, 21), (20, 2), (20, 7))
    assert "gap 40 is left out: of 30 frames" in caplog.text
    pairs = list(planned)
    assert len(pairs) == len(planned) == 4
    for (gap, first), pair in zip(planned.frames, pairs, strict=True):
        expected = inverse(poses[first + gap]) @ poses[first]
        np.testing.assert_allclose(pair.second_from_first, expected, atol=1e-4)


def test_frames_whose_truth_is_missing_are_in_no_pair(synthetic_stereo: Path) -> None:
    recording: Any = vo.open(synthetic_stereo, mode="mono")
    truth = recording.ground_truth
    stamps = recording.stamps_ns
    known = truth.stamps_ns >= stamps[12]
    recording.ground_truth = Trajectory(truth.stamps_ns[known], truth.world_from_cam[known])
    planned = plan_pairs(recording, [5], 100)
    assert min(first for _, first in planned.frames) == 12
    with pytest.raises(SourceError, match=r"18 of 30 frames have a true pose.*smaller `gaps`"):
        plan_pairs(recording, [20], 100)


def test_frames_that_cannot_be_read_are_left_out() -> None:
    image = np.zeros((4, 4), np.uint8)

    def frames(start: int, end: int) -> list[vo.Frame]:
        return [] if start == 1 else [vo.Frame(start, start, (image,))]

    truth = Trajectory(np.arange(4), np.broadcast_to(np.eye(4), (4, 4, 4)))
    recording: Any = SimpleNamespace(
        name="x", stamps_ns=np.arange(4), ground_truth=truth, frames=frames
    )
    planned = plan_pairs(recording, [1], 9)
    assert (len(planned), len(list(planned))) == (3, 1)


def test_without_ground_truth_it_says_what_is_possible(synthetic_stereo: Path) -> None:
    recording: Any = vo.open(synthetic_stereo, mode="mono")
    recording.ground_truth = None
    with pytest.raises(SourceError, match="no ground truth.*`frame=N`.*vo synth"):
        plan_pairs(recording, [1], 1)
    far = Trajectory(np.arange(3), np.broadcast_to(np.eye(4), (3, 4, 4)))
    recording.ground_truth = replace(far)
    with pytest.raises(SourceError, match="0 of 30 frames have a true pose"):
        plan_pairs(recording, [1], 1)
