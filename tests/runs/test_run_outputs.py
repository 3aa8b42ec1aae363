"""What a run's files say of a slightly wrong stereo calibration and of frames placed later."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from vo.base.config import load_config
from vo.base.types import Mode
from vo.recordings.formats.trajectory import read_tum
from vo.runs.run_recording import run

SHIFT_PX = 0.5
FRAMES = 20


def _summary(source: Path, output: Path, mode: Mode = "auto") -> dict[str, Any]:
    run(source, output, config=load_config("fast"), end=FRAMES, mode=mode)
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(summary, dict)
    return summary


def _told(summary: dict[str, Any]) -> list[str]:
    return [sentence for sentence in summary["warnings"] if "disparities" in sentence]


def _shift_right_images(source: Path) -> None:
    """To the left, so that every disparity grows."""
    move = np.array([[1.0, 0.0, -SHIFT_PX], [0.0, 1.0, 0.0]])
    for path in sorted((source / "mav0" / "cam1" / "data").iterdir())[:FRAMES]:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        size = (image.shape[1], image.shape[0])
        shifted = cv2.warpAffine(
            image, move, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        assert cv2.imwrite(str(path), shifted)


def test_a_disparity_offset_is_told(synthetic_stereo: Path, tmp_path: Path) -> None:
    source = Path(shutil.copytree(synthetic_stereo, tmp_path / "shifted"))
    _shift_right_images(source)
    summary = _summary(source, tmp_path / "out")
    assert summary["tracked"] == FRAMES
    assert summary["disparity_offset_px"] == pytest.approx(SHIFT_PX, abs=0.15)
    (sentence,) = _told(summary)
    assert f"wrong by {summary['disparity_offset_px']:+.2f} px and have been corrected" in sentence


def test_without_a_disparity_offset_nothing_is_told(synthetic_stereo: Path, tmp_path: Path) -> None:
    summary = _summary(synthetic_stereo, tmp_path)
    assert summary["tracked"] == FRAMES
    assert abs(summary["disparity_offset_px"]) < 0.05
    assert _told(summary) == []


def test_frames_placed_later_stand_in_the_smoothed_path_only(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    summary = _summary(synthetic_stereo, tmp_path, mode="mono")
    smoothed, causal = read_tum(tmp_path / "trajectory.tum"), read_tum(tmp_path / "causal.tum")
    true = read_tum(synthetic_stereo / "groundtruth.tum")
    np.testing.assert_array_equal(smoothed.stamps_ns, true.stamps_ns[:FRAMES])
    assert 2 < len(causal) < FRAMES - 1  # the first frame and at least one after it came later
    np.testing.assert_array_equal(causal.stamps_ns, smoothed.stamps_ns[-len(causal) :])
    assert (summary["tracked"], summary["starting"]) == (FRAMES, 0)
    assert summary["without_pose"] == []
