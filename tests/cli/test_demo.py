from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from data_synth import recipe
from data_synth.recipe import load_recipe
from vo.cli.app import app


@pytest.fixture
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    small = ["motion=handheld", "seconds=1", "fps=12", "scale=0.5"]  # a loop takes longer
    monkeypatch.setattr(recipe, "load_recipe", lambda name: load_recipe(name, small))


@pytest.mark.usefixtures("_small")
def test_demo_renders_runs_evaluates_and_keeps_the_recording(tmp_path: Path) -> None:
    output = tmp_path / "demo"
    result = CliRunner().invoke(app, ["demo", "--output", str(output)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert "12 of 12 frames" in result.output
    assert "ATE, translation" in result.output
    assert f" view {output / 'run'} " in result.output
    assert f" report {output / 'run'} " in result.output
    for name in ("run/trajectory.tum", "run/run.rrd", "run/eval.png", "run/summary.json"):
        assert (output / name).stat().st_size > 0
        if name.endswith(("rrd", "png")):
            assert str(output / name) in result.output.replace("\n", "")
    recordings = [p for p in output.iterdir() if p.name.startswith("recording-")]
    assert len(recordings) == 1

    image = next(recordings[0].rglob("*.png"))
    before = image.stat().st_mtime_ns
    again = CliRunner().invoke(app, ["demo", "--output", str(output)], catch_exceptions=False)
    assert again.exit_code == 0, again.output
    assert "made earlier" in again.output
    assert image.stat().st_mtime_ns == before


@pytest.mark.usefixtures("_small")
def test_demo_prints_json_alone(tmp_path: Path) -> None:
    words = ["demo", "--output", str(tmp_path / "demo"), "--json", "-q"]
    result = CliRunner().invoke(app, words, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert printed["summary"]["tracked"] == 12
    assert Path(printed["rrd"]).is_file() and Path(printed["picture"]).is_file()
    assert printed["evaluation"]["ate"]


@pytest.mark.usefixtures("_small")
def test_an_output_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = CliRunner().invoke(app, ["demo", "--output", str(tmp_path / "file" / "demo")])
    assert result.exit_code == 1
    assert "error: " in result.output
    assert "Traceback" not in result.output
