"""Verdict and advice at the end of a run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from vo.base.config import load_config
from vo.base.failures import Failure, FailureReason, ImageDefect
from vo.base.faults import FaultKind
from vo.cli.advice import advice, verdict_sentence
from vo.outputs.results.run_statistics import FaultRecord, FrameRange
from vo.outputs.results.summary import Summary
from vo.runs.run_recording import run


@pytest.fixture(scope="module")
def good(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Summary:
    folder = tmp_path_factory.mktemp("table")
    return run(synthetic_stereo, folder, config=load_config("fast"), end=6)


def test_a_good_run_needs_no_advice(good: Summary) -> None:
    assert good.verdict == ("good", "complete", True)
    assert verdict_sentence(good) == "complete: all 6 frames have a pose"
    assert advice(good) == []


def test_lost_frames_are_listed_with_advice(good: Summary) -> None:
    ranges = (FrameRange(2, 3, 2, "lost", "too few"), FrameRange(5, 5, 1, "lost", "too few"))
    lost = replace(good, tracked=3, lost=3, without_pose=ranges, segments=good.segments * 2)
    assert lost.verdict.grade == "caution"
    assert verdict_sentence(lost) == (
        "with gaps: 3 of 6 frames have a pose (50.0%), in 2 segments that are not connected"
    )
    lines = advice(lost)
    assert "frames 2 to 3, 5" in lines[0] and "--rrd" in lines[0]
    assert "--config accurate" in lines[1]


def test_a_run_without_tracked_frames_is_bad_and_gets_advice(good: Summary) -> None:
    nothing = replace(good, tracked=0, starting=6, segments=(), median_inliers=None)
    assert nothing.verdict == ("bad", "no path", False)
    assert verdict_sentence(nothing) == "no path: none of the 6 frames has a pose"
    assert "check the calibration" in advice(nothing)[0]
    assert "--mode mono" in advice(nothing)[1]
    mono = replace(nothing, facts=replace(nothing.facts, mode="mono"))
    for reason, told in (
        (FailureReason.PURE_ROTATION, "moves sideways"),
        (FailureReason.LITTLE_MOTION, "begins to move"),
        (FailureReason.FEW_FEATURES, "textured scenes"),
        (FailureReason.FEW_MATCHES, "little in common"),
    ):
        assert told in advice(replace(mono, main_failure=Failure(reason)))[0]
    dark = Failure(FailureReason.FEW_MATCHES, 3, 80, ImageDefect.DARK)
    assert advice(replace(mono, main_failure=dark)) == []


def test_a_run_with_few_inliers_is_not_good(good: Summary) -> None:
    poor = replace(good, median_inliers=22.0)
    assert poor.verdict == ("caution", "unreliable", False)
    assert "few inlier landmarks" in advice(poor)[0]


def test_verdict_on_an_interrupted_run(good: Summary) -> None:
    assert verdict_sentence(replace(good, status="interrupted")).startswith("interrupted: ")


def test_a_fault_that_is_not_handled_makes_a_run_untrusted(good: Summary) -> None:
    kind = FaultKind.REPEATED_IMAGES
    handled = replace(good, faults=(FaultRecord(kind, True, 2, 3, 4, 0.0),))
    assert handled.verdict == ("caution", "complete, with warnings", True)
    assert handled.warnings == (
        "images repeat the one before while the camera moves, and get no pose: frames 3 to 4; "
        "check the camera driver",
    )
    wrong = replace(good, faults=(FaultRecord(kind, False, 2, 3, 5, 0.0),))
    assert wrong.verdict == ("bad", "not to be trusted", False)
    assert verdict_sentence(wrong) == "not to be trusted: all 6 frames have a pose"
    assert "2 of the frames 3 to 5" in wrong.warnings[0]
    assert replace(wrong, status="interrupted").verdict.word == "interrupted, not to be trusted"


def test_a_path_with_a_large_correction_of_disparities_is_doubted(good: Summary) -> None:
    assert replace(good, disparity_offset_px=0.15).verdict.is_trusted
    corrected = replace(good, disparity_offset_px=-0.26)
    assert corrected.verdict == ("bad", "not to be trusted", False)
    assert "all disparities were wrong by -0.26 px" in corrected.warnings[0]
