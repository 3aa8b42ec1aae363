"""`vo memory show`: bags of words of a run, and its loops."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner, Result

from vo.base.config import load_config
from vo.cli.app import app
from vo.runs.run_recording import run


def show(*words: object) -> Result:
    return CliRunner().invoke(app, ["memory", "show", *map(str, words)], catch_exceptions=False)


@pytest.fixture(scope="module")
def finished(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run whose summary has a loop between its first and its last frame."""
    folder = tmp_path_factory.mktemp("memory") / "out"
    run(synthetic_stereo, folder, config=load_config("fast"), end=20)
    path = folder / "summary.json"
    summary = json.loads(path.read_text(encoding="utf-8"))
    assert summary["loops"] == []
    summary["loops"] = [
        {"kind": "loop", "frame": 19, "earlier_frame": 0, "segment": 0, "earlier_segment": 0}
        | {"inliers": 99, "corrected_from": None, "correction_m": 0.0, "correction_deg": 0.0}
    ]
    path.write_text(json.dumps(summary), encoding="utf-8")
    return folder


def test_loops_have_scores_and_ranks_and_a_picture(finished: Path, tmp_path: Path) -> None:
    picture = tmp_path / "loops.png"
    result = show(finished, "--picture", picture, "--json")
    assert result.exit_code == 0, result.output
    record = json.loads(result.stdout)
    (loop,) = record["loops"]
    assert (loop["frame"], loop["earlier_frame"]) == (19, 0)
    assert 0.03 < loop["score"] <= 1.0 and loop["relative"] > 0.0 and loop["rank"] >= 1
    assert record["keyframes"] >= 3
    assert cv2.imread(str(picture)) is not None
    assert "loop        19        0" in show(finished).stdout


def test_what_is_no_run_is_one_line(tmp_path: Path) -> None:
    result = show(tmp_path)
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
