"""Runs on pairs whose right image is that of the frame before."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from vo.base.config import load_config
from vo.base.types import Floats
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run


def _extent(positions: Floats) -> float:
    return float(np.linalg.norm(positions - positions.mean(axis=0)))


def test_a_run_on_late_right_images_says_so_and_is_not_trusted(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    interval_ns = int(np.median(np.diff(open_source(synthetic_stereo).stamps_ns)))
    # Each left image with the right one of the frame before.
    config = load_config("default", [])
    run(synthetic_stereo, tmp_path / "out", config=config, right_offset_ns=interval_ns)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["verdict"] == "not to be trusted" and not summary["trusted"]
    (fault,) = [each for each in summary["faults"] if each["kind"] == "right_time_offset"]
    assert fault["value"] == pytest.approx(-1e-6 * interval_ns, rel=0.05)
    text = "\n".join(summary["warnings"])
    assert (
        "by -6" in text and "`right_offset_ns`" in text and "the stereo calibration is" not in text
    )
    assert "differs from its calibration" not in text


def test_a_sound_run_has_no_such_fault(synthetic_stereo: Path, tmp_path: Path) -> None:
    run(synthetic_stereo, tmp_path / "out", config=load_config("default", []))
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["faults"] == [] and summary["trusted"]
    estimate = read_tum(tmp_path / "out" / "trajectory.tum")
    true = read_tum(synthetic_stereo / "groundtruth.tum")
    assert _extent(estimate.positions) / _extent(true.positions) == pytest.approx(1.0, abs=0.01)
