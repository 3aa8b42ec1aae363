"""A camera with depth, from the recording to the error of the path."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from vo.base.config import load_config
from vo.outputs.evaluation.evaluation import evaluate
from vo.outputs.evaluation.inputs import load_inputs
from vo.runs.run_recording import run


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from data_synth.recipe import load_recipe
    from data_synth.sequence import make_sequence

    settings = ["seconds=2", "fps=10", "scale=0.5", "speed=1.5"]
    folder = tmp_path_factory.mktemp("rgbd") / "walk"
    make_sequence(folder, load_recipe("tum", settings))
    return folder


def test_the_path_is_metric_and_near_the_truth(walk: Path, tmp_path: Path) -> None:
    summary = run(walk, tmp_path, config=load_config("fast"))
    assert summary.tracked == summary.frames
    assert summary.facts.mode == "rgbd"
    assert summary.length_unit == "m"
    assert json.loads((tmp_path / "summary.json").read_text())["mode"] == "rgbd"
    inputs = load_inputs(tmp_path, walk)
    found = evaluate(inputs.estimate, inputs.reference, "auto", inputs.mode).to_dict()
    assert found["alignment"]["kind"] == "se3"
    assert abs(found["scale_error_percent"]) < 1.0
    assert found["ate"]["translation_m"]["rmse"] < 0.005 * found["path_m"]


def test_depth_may_be_ignored(walk: Path, tmp_path: Path) -> None:
    summary = run(walk, tmp_path, config=load_config("fast"), mode="mono")
    assert summary.facts.mode == "mono"
    assert summary.length_unit == "map units"
