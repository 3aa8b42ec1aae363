"""Verdict and advice at the end of a run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from vo.cli.advice import advice, verdict
from vo.config import load_config
from vo.results.frames_without_pose import FrameRange
from vo.results.summary import Summary
from vo.run import run


@pytest.fixture(scope="module")
def good(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Summary:
    folder = tmp_path_factory.mktemp("table")
    return run(synthetic_stereo, folder, config=load_config("fast"), end=6)


def test_a_good_run_needs_no_advice(good: Summary) -> None:
    assert verdict(good) == ("good", "complete: all 6 frames have a pose")
    assert advice(good) == []


def test_lost_frames_are_listed_with_advice(good: Summary) -> None:
    ranges = (FrameRange(2, 3, 2, "lost", "too few"), FrameRange(5, 5, 1, "lost", "too few"))
    lost = replace(good, tracked=3, lost=3, without_pose=ranges, segments=good.segments * 2)
    grade, sentence = verdict(lost)
    assert grade == "caution"
    assert sentence == (
        "with gaps: 3 of 6 frames have a pose (50.0%), in 2 segments that are not connected"
    )
    lines = advice(lost)
    assert "frames 2 to 3, 5" in lines[0] and "--rrd" in lines[0]
    assert "--config accurate" in lines[1]


def test_a_run_without_tracked_frames_is_bad_and_gets_advice(good: Summary) -> None:
    nothing = replace(good, tracked=0, starting=6, segments=(), median_inliers=None)
    assert verdict(nothing) == ("bad", "no path: none of the 6 frames has a pose")
    assert "check the calibration" in advice(nothing)[0]
    assert "--mode mono" in advice(nothing)[1]
    mono = replace(nothing, facts=replace(nothing.facts, mode="mono"))
    assert "moves sideways" in advice(mono)[0]


def test_a_run_with_few_inliers_is_not_good(good: Summary) -> None:
    poor = replace(good, median_inliers=22.0)
    assert verdict(poor).grade == "caution"
    assert "few inlier landmarks" in advice(poor)[0]


def test_verdict_on_an_interrupted_run(good: Summary) -> None:
    assert verdict(replace(good, status="interrupted")).sentence.startswith("interrupted: ")
