"""Two batches: ratios, intervals, and the exit status."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from vo.base.errors import EvaluationError
from vo.cli.app import app
from vo.runs.batch.comparison import compare
from vo.runs.batch.job import JobResult, JobStatus
from vo.runs.batch.planning import Plan
from vo.runs.batch.tables import table_text, write_tables


def results(
    scale: float = 1.0, count: int = 40, noise: float = 0.0, seed: int = 5
) -> list[JobResult]:
    rng = np.random.default_rng(seed)
    return [
        JobResult(
            f"walk{n}",
            f"walk{n}.mcap",
            JobStatus.DONE,
            ate_m=0.1 * (n + 1) * scale * float(np.exp(noise * rng.normal())),
            tracked_ratio=0.9,
            cpu_s=2.0,
        )
        for n in range(count)
    ]


def test_equal_batches_have_ratios_of_one() -> None:
    compared = compare(results(), results())
    assert [(c.ratio, c.low, c.high) for c in compared.changes] == [(1.0, 1.0, 1.0)] * 3
    assert compared.worse_than(0.0) == ()
    assert compared.lost == ()


def test_intervals_have_the_true_ratio_in_them_as_often_as_they_say() -> None:
    changes = [
        compare(results(), results(1.1, noise=0.1, seed=seed)).changes[0] for seed in range(60)
    ]
    assert sum(each.low < 1.1 < each.high for each in changes) >= 52  # 57 are expected
    width = np.mean([np.log(each.high / each.low) for each in changes])
    assert width == pytest.approx(2 * 1.96 * 0.1 / np.sqrt(40), rel=0.1)


def test_the_interval_is_the_same_each_time() -> None:
    assert compare(results(), results(1.1, noise=0.2)) == compare(
        results(), results(1.1, noise=0.2)
    )


def test_noise_alone_is_not_worse() -> None:
    assert compare(results(), results(1.0, noise=0.3, seed=1)).worse_than(0.0) == ()


def test_fewer_poses_are_worse_and_worst_recordings_come_first() -> None:
    after = results()
    after[3] = replace(after[3], tracked_ratio=0.45)
    after[7] = replace(after[7], status=JobStatus.CRASHED)
    compared = compare(results(), after)
    assert [row.name for row in compared.rows[:2]] == ["walk7", "walk3"]
    assert compared.rows[1].ratios["tracked_ratio"] == 2.0
    assert compared.lost == ("walk7",)


def test_batches_of_other_recordings_are_refused() -> None:
    with pytest.raises(EvaluationError, match="no recording in common"):
        compare(results(), [replace(results()[0], name="other")])


@pytest.fixture
def folders(tmp_path: Path) -> list[str]:
    for name, scale in (("v1", 1.0), ("v2", 1.04), ("v3", 1.2)):
        (tmp_path / name).mkdir()
        write_tables(tmp_path / name, results(scale, noise=0.01), Plan(()))
    return [str(tmp_path / name) for name in ("v1", "v2", "v3")]


def test_the_exit_status_tells_whether_it_became_worse(folders: list[str]) -> None:
    first, second, third = folders
    call = CliRunner().invoke
    assert call(app, ["compare", first, third]).exit_code == 0
    assert call(app, ["compare", first, second, "--fail-if-worse", "5%"]).exit_code == 0
    assert call(app, ["compare", first, third, "--fail-if-worse", "5%"]).exit_code == 4
    assert call(app, ["compare", third, first, "--fail-if-worse", "0"]).exit_code == 0
    assert call(app, ["compare", first, second, "--fail-if-worse", "much"]).exit_code == 2


def test_the_page_and_json_have_the_figures(folders: list[str], tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    words = ["compare", folders[0], folders[2], "-o", str(page), "--json"]
    done = CliRunner().invoke(app, words)
    [ate, *_] = json.loads(done.stdout)["changes"]
    assert ate["ratio"] == pytest.approx(1.2)
    assert "1.200 to 1.200" in page.read_text()
    assert page.read_text().count('scope="row"') == 43


def test_a_folder_without_a_batch_is_one_line(folders: list[str], tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    done = CliRunner().invoke(app, ["compare", folders[0], str(tmp_path / "other")])
    assert done.exit_code == 1
    assert done.stderr == (
        f"error: {tmp_path}/other has no batch.json; use the --output of a `vo batch`\n"
    )
    (tmp_path / "other" / "batch.json").write_text("[]")
    done = CliRunner().invoke(app, ["compare", folders[0], str(tmp_path / "other")])
    assert done.exit_code == 1
    assert "is not the summary of a batch" in done.stderr


def test_names_that_look_like_formulas_are_text_in_the_table() -> None:
    rows = table_text([JobResult("=cmd|' /C calc'!A0", "walk", JobStatus.DONE, tags={"t": "@x"})])
    assert "'=cmd" in rows and "'@x" in rows and not rows.splitlines()[1].startswith("=")


@pytest.mark.parametrize(
    "result", [7, {"name": 7}, {"ate_m": "far"}, {"tags": 3}, {"tags": {"a": None}}, {"status": []}]
)
def test_a_damaged_batch_is_one_line(tmp_path: Path, result: object) -> None:
    whole = results(count=1)[0].to_dict()
    damaged = whole | result if isinstance(result, dict) else result
    (tmp_path / "batch.json").write_text(json.dumps({"results": [damaged]}))
    found = CliRunner().invoke(app, ["compare", str(tmp_path), str(tmp_path)])
    assert found.exit_code == 1 or result == {"tags": {"a": None}}
    assert found.exception is None or isinstance(found.exception, SystemExit)
