"""The table of robustness: its rows, its measure, and what it calls wrong."""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from vo.base.geometry.transforms import so3_exp
from vo.base.types import Floats

MODULES = tuple(f"robustness_{name}" for name in ("cases", "run", "table", "clips", "store"))


@pytest.fixture(scope="module")
def scripts() -> Iterator[dict[str, ModuleType]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parent.parent / "scripts"))
        yield {name: importlib.import_module(name) for name in MODULES}
    for name in [n for n in sys.modules if n.startswith("robustness_")]:
        sys.modules.pop(name)


@pytest.fixture
def truth() -> Floats:
    poses = np.tile(np.eye(4), (50, 1, 1))
    poses[:, 0, 3] = np.linspace(0.0, 5.0, 50)
    poses[:, 2, 3] = np.sin(np.linspace(0.0, 3.0, 50))
    return poses


def poses_csv(path: Path, positions: Floats, segments: Floats | None = None) -> Path:
    from vo.outputs.results.tables import POSES_HEADING

    numbers = np.zeros(len(positions)) if segments is None else segments
    rows = [
        f"{i},{i},{int(segment)},0,0,{x},{y},{z},0,0,0,1"
        for i, (segment, (x, y, z)) in enumerate(zip(numbers, positions, strict=True))
    ]
    path.write_text("\n".join([POSES_HEADING, *rows]) + "\n")
    return path


def test_rows_have_unique_names_and_known_clips(scripts: dict[str, ModuleType]) -> None:
    rows = scripts["robustness_cases"].cases(Path("vo"))
    assert len({row.name for row in rows}) == len(rows) > 150
    assert {row.clip for row in rows} <= set(scripts["robustness_cases"].CLIPS)
    assert len({row.situation for row in rows if row.is_quick}) > 15


@pytest.mark.parametrize("with_scale", [False, True])
def test_a_moved_path_has_no_error(
    scripts: dict[str, ModuleType], truth: Floats, tmp_path: Path, with_scale: bool
) -> None:
    scale = 3.0 if with_scale else 1.0
    moved = scale * truth[:, :3, 3] @ so3_exp(np.array([0.3, 0.2, -0.5])).T + 7.0
    file = poses_csv(tmp_path / "poses.csv", moved)
    ate, step = scripts["robustness_run"].errors(file, truth, with_scale)
    assert ate == pytest.approx(0.0, abs=1e-9)
    steps = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1)
    assert step == pytest.approx(steps.max())


def test_a_standing_camera_can_be_scored(
    scripts: dict[str, ModuleType], truth: Floats, tmp_path: Path
) -> None:
    standing = np.repeat(truth[:1], len(truth), axis=0)
    file = poses_csv(tmp_path / "poses.csv", truth[:, :3, 3])
    ate, _ = scripts["robustness_run"].errors(file, standing, False)
    assert ate == pytest.approx(np.sqrt(truth[:, :3, 3].var(axis=0).sum()))


def test_segments_are_aligned_one_by_one(
    scripts: dict[str, ModuleType], truth: Floats, tmp_path: Path
) -> None:
    positions = truth[:, :3, 3].copy()
    positions[25:] += 100.0
    file = poses_csv(tmp_path / "poses.csv", positions, np.arange(50) >= 25)
    ate, step = scripts["robustness_run"].errors(file, truth, False)
    assert ate == pytest.approx(0.0, abs=1e-9)
    assert step < 1.0


@pytest.mark.parametrize(
    ("ate_m", "trusted", "grade"),
    [
        (0.02, True, "right"),
        (0.02, False, "right, but doubted"),
        (0.5, False, "wrong, and says so"),
        (0.5, True, "WRONG AND TRUSTED"),
        (None, False, "no path"),
    ],
)
def test_a_row_is_graded(
    scripts: dict[str, ModuleType], ate_m: float | None, trusted: bool, grade: str
) -> None:
    def outcome(ate: float | None, is_trusted: bool) -> Any:
        return scripts["robustness_run"].Outcome(ate, 1.0, 0.3, "complete", is_trusted, (), "")

    row = scripts["robustness_table"].Row(
        "frozen", "3 frames", "hall stereo", outcome(ate_m, trusted), outcome(0.01, True), 0.03
    )
    assert row.grade == grade
    assert row.is_wrong_and_trusted == (grade == "WRONG AND TRUSTED")
    assert grade in scripts["robustness_table"].document([row], [])


def test_frames_without_a_left_image_have_no_truth(
    scripts: dict[str, ModuleType], truth: Floats
) -> None:
    image = np.zeros((4, 4), np.uint8)
    left = [None if 10 <= i < 20 else image for i in range(50)]
    stamps = np.arange(50)
    clip = scripts["robustness_clips"].Clip("x", (left, [image] * 50), (stamps,), None, truth)
    expected = np.delete(truth, np.arange(10, 20), axis=0)
    np.testing.assert_array_equal(clip.truth_of_frames, expected)


def test_rows_of_the_same_commit_are_found_again(
    scripts: dict[str, ModuleType], tmp_path: Path
) -> None:
    def outcome(ate: float) -> Any:
        return scripts["robustness_run"].Outcome(ate, 1.0, 0.3, "complete", True, ("frozen!",), "")

    def git(*words: str) -> None:
        identity = ("-c", "user.name=x", "-c", "user.email=x@example.org")
        subprocess.run(["git", "-C", str(tmp_path), *identity, *words], check=True)

    def commit(text: str) -> Any:
        (tmp_path / "code").write_text(text)
        git("add", "code")
        git("commit", "-qm", text)
        return store()

    def store() -> Any:
        return scripts["robustness_store"].Store(tmp_path / "rows.jsonl", tmp_path / "vo")

    table = scripts["robustness_table"]
    row = table.Row("bonnet", "10 %", "hall", outcome(0.1), outcome(0.01), 0.05)
    clean = table.CleanRow("clean, hall", outcome(0.01))
    git("init", "-q")
    first = commit("one")
    first.add("bonnet, 10 %, hall", row, 3.0)
    with (tmp_path / "rows.jsonl").open("a") as file:
        file.write('{"name": "broken off", "outcome": {}')
    first.add(clean.name, clean, 2.0)
    assert store().find("bonnet, 10 %, hall") == row
    assert store().find(clean.name) == clean
    assert store().find("bonnet, 20 %, hall") is None
    (tmp_path / "code").write_text("changed")
    assert store().find(clean.name) is None
    assert commit("two").find(clean.name) is None
