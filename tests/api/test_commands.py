"""The commands as functions, and a user's program under strict type checking."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import vo

ROOT = Path(__file__).resolve().parents[2]


def test_a_recording_is_made_inspected_converted_run_and_reported(tmp_path: Path) -> None:
    words = {"seconds": 2.0, "mono": True, "camera": "pinhole"}
    walk = vo.synth(tmp_path / "walk", overrides=["scale=0.25"], **words)  # type: ignore[arg-type]
    found = vo.info(walk)
    assert (found.format, len(found.cameras), found.pair) == ("euroc", 1, None)
    short = vo.convert(walk, tmp_path / "short", end=20, to="kitti")
    assert len(vo.open(short)) == 20  # type: ignore[arg-type]
    vo.run(short, tmp_path / "out", "fast")
    pytest.importorskip("matplotlib")
    page = vo.report(tmp_path / "out", images=False)
    assert page == tmp_path / "out" / "report.html" and page.stat().st_size > 10_000
    film = vo.video(tmp_path / "out", output=tmp_path / "run.mp4", end=12, width=640)
    assert film.images == 12 and film.output.stat().st_size > 10_000


def test_a_batch_runs_all(synthetic_stereo: Path, tmp_path: Path) -> None:
    shutil.copytree(synthetic_stereo, tmp_path / "all" / "a")
    result = vo.batch(tmp_path / "all", tmp_path / "out", "fast", jobs=1)
    assert [each.name for each in result.results] == ["a"] and not result.unfinished


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: vo.convert(p, p / "x", too="kitti"), "unknown option 'too'; did you mean 'to'?"),
        (lambda p: vo.convert(p / "a", p / "x", resize="big"), "invalid `resize=big`"),
        (lambda p: vo.info(p, mod="mono"), "unknown option 'mod'; did you mean 'mode'?"),
        (lambda p: vo.synth(p / "x", second=3), "unknown option 'second'"),
        (lambda p: vo.calibrate(p, sqare=0.1), "unknown option 'sqare'; did you mean 'square'?"),
        (lambda p: vo.calibrate(p, columns=2), "2"),
        (lambda p: vo.batch(p, p / "o", jobs="2"), "the option jobs is '2', not a whole number"),
    ],
)
def test_what_cannot_be_meant_is_refused(call, message: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(vo.ConfigError) as error:
        call(tmp_path)
    assert message in str(error.value)


def test_a_users_program_is_typed() -> None:
    pytest.importorskip("mypy")
    program = Path(__file__).with_name("user_program.py")
    words = ["--strict", "--config-file=", "--follow-imports=silent", "--warn-unused-ignores"]
    result = subprocess.run(
        [sys.executable, "-m", "mypy", *words, "--ignore-missing-imports", str(program)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout
