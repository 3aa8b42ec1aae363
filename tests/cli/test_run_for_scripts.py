"""`vo run` in a script: JSON, warnings on standard error, exit status, and the list of files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import typer
from run_calls import summary_in, vo_run

from vo.base.config import load_config
from vo.cli.run_execution import NO_PATH, UNDER_SHARE, exit_if_insufficient, parse_share
from vo.outputs.results.summary import Summary
from vo.runs.run_recording import run

FILES = (
    *("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv", "frames.csv"),
    *("summary.json", "config.yaml"),
)
NO_POSE = "no frame was tracked (0 matches with the reference frame, 80 needed; the image is very"


@pytest.fixture(scope="module")
def good(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Summary:
    folder = tmp_path_factory.mktemp("script")
    return run(synthetic_stereo, folder, config=load_config("fast"), end=6)


def status_of(call: Callable[[], None]) -> int:
    try:
        call()
    except typer.Exit as end:
        return end.exit_code
    return 0


def test_json_is_the_summary_with_the_files(synthetic_stereo: Path, out: Path) -> None:
    ply, rrd = out / "map.ply", out / "run.rrd"
    result = vo_run(
        synthetic_stereo, out, "--json", "--end", 6, "--config", "fast", "--ply", ply, "--rrd", rrd
    )
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    files = [str(path) for path in (*(out / name for name in FILES), rrd, ply)]
    assert printed.pop("output") == str(out)
    assert printed.pop("files") == files
    assert printed == summary_in(out)
    assert "frame 1/6" in result.stderr


def test_the_text_lists_every_file(synthetic_stereo: Path, out: Path) -> None:
    mcap, colmap = out.parent / "run.mcap", out.parent / "model"
    given = ("--mcap", mcap, "--colmap", colmap, "--end", 6, "--config", "fast")
    result = vo_run(synthetic_stereo, out, *given)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert f"output     {out}: {', '.join(FILES)}" in lines
    assert f"mcap       {mcap}" in lines
    assert f"colmap     {colmap}" in lines
    assert f"next: vo report {out}" in lines


def test_quiet_prints_warnings_on_standard_error_only(images: Path, out: Path) -> None:
    result = vo_run(images, out, "--quiet")
    assert result.exit_code == NO_PATH
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert lines == [f"warning: {text}" for text in summary_in(out)["warnings"]]
    assert any(line.startswith(f"warning: {NO_POSE}") for line in lines)


def test_json_comes_with_warnings_on_standard_error(images: Path, out: Path) -> None:
    result = vo_run(images, out, "--json", "--quiet")
    assert result.exit_code == NO_PATH
    assert json.loads(result.stdout)["verdict"] == "no path"
    assert f"warning: {NO_POSE}" in result.stderr


def test_verbose_tells_what_is_read_and_decided(images: Path, out: Path) -> None:
    result = vo_run(images, out, "--verbose")
    assert f"{images}: recording of format folder" in result.stderr
    assert f"{images / 'calibration.yaml'}: calibration of format vo" in result.stderr
    assert "images: 5 images of 96x64, one camera" in result.stderr
    assert "frame 0: starting (this is the reference frame)" in result.stderr
    after = vo_run(images, out)
    assert "recording of format" not in after.stderr


@pytest.mark.parametrize(
    ("text", "value"), [("90%", 0.9), ("90 %", 0.9), ("0.9", 0.9), ("1", 1.0), ("0%", 0.0)]
)
def test_a_share_is_read(text: str, value: float) -> None:
    assert parse_share(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["90", "-1", "101%", "x", "nan", "inf", "1e-3"])
def test_other_shares_are_wrong_usage(text: str, images: Path, out: Path) -> None:
    result = vo_run(images, out, "--fail-under", text)
    assert result.exit_code == 2
    assert "90% or 0.9" in " ".join(result.stderr.split())
    assert not out.exists()


def with_values(summary: Summary, **values: object) -> Summary:
    return replace(summary, **values)  # type: ignore[arg-type]


def test_the_status_tells_how_complete_the_path_is(good: Summary) -> None:
    half = with_values(good, tracked=3, lost=3)
    assert status_of(lambda: exit_if_insufficient(good, None)) == 0
    assert status_of(lambda: exit_if_insufficient(good, 1.0)) == 0
    assert status_of(lambda: exit_if_insufficient(half, None)) == 0
    assert status_of(lambda: exit_if_insufficient(half, 0.5)) == 0
    assert status_of(lambda: exit_if_insufficient(half, 0.51)) == UNDER_SHARE
    nothing = with_values(good, tracked=0, starting=6)
    assert status_of(lambda: exit_if_insufficient(nothing, None)) == NO_PATH
    assert status_of(lambda: exit_if_insufficient(nothing, 0.5)) == NO_PATH


def test_a_path_not_to_be_trusted_never_reaches_a_share(
    good: Summary, capsys: pytest.CaptureFixture[str]
) -> None:
    doubted = with_values(good, disparity_offset_px=0.3)
    assert doubted.verdict.word == "not to be trusted"
    assert status_of(lambda: exit_if_insufficient(doubted, None)) == 0
    assert status_of(lambda: exit_if_insufficient(doubted, 0.0)) == UNDER_SHARE
    assert "not to be trusted, see the warnings" in capsys.readouterr().err


def test_fail_under_passes_a_complete_path(synthetic_stereo: Path, out: Path) -> None:
    given = ("-q", "--end", 6, "--config", "fast", "--fail-under", "100%")
    assert vo_run(synthetic_stereo, out, *given).exit_code == 0
