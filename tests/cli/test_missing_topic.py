"""A topic that a log does not have: whole sentences, and a command that works."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from vo.cli.app import app


@pytest.fixture
def log(images: Path, tmp_path: Path) -> Path:
    path = tmp_path / "log.mcap"
    assert CliRunner().invoke(app, ["convert", str(images), str(path)]).exit_code == 0
    return path


def test_info_names_the_topics_and_leaves_the_missing_one_out(log: Path) -> None:
    result = CliRunner().invoke(app, ["info", str(log), "--topic", "/zzz"])
    assert result.exit_code == 1
    lines = result.stdout.splitlines()
    assert "problem: there is no topic /zzz; the log has /cam0/image_raw/compressed" in lines
    assert f"try: vo run {log} -o out/log" in lines


@pytest.mark.parametrize("words", [["convert", "{log}", "out"], ["run", "{log}", "-o", "out"]])
def test_other_commands_list_the_topics(
    words: list[str], log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, [*(w.format(log=log) for w in words), "--topic", "/zzz"])
    assert result.exit_code == 1
    first, *rest = result.stderr.splitlines()
    assert first == "error: there is no topic /zzz; the log has /cam0/image_raw/compressed"
    assert rest == ["  /cam0/image_raw/compressed  foxglove.CompressedImage  5 messages  10.0 Hz"]
