"""Results on a full disk: whole lines, one error, and a summary that is true."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from vo.base.errors import OutputError
from vo.outputs.results.folder import RESULTS, RunFolder
from vo.outputs.results.growing_file import GrowingFile, ReservedSpace
from vo.recordings.formats.trajectory import read_tum

VO = Path(sys.executable).with_name("vo")


class FullFile:
    """A file on a disk with room for some bytes; a write takes what fits, as the system does."""

    def __init__(self, file: object, room: int) -> None:
        self._file, self._room = file, room

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)

    def write(self, data: memoryview) -> int:
        left = self._room - self._file.tell()  # type: ignore[attr-defined]
        if left <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return int(self._file.write(data[:left]))  # type: ignore[attr-defined]


@pytest.mark.parametrize("room", range(8, 30))
def test_a_file_on_a_full_disk_ends_with_a_whole_line(tmp_path: Path, room: int) -> None:
    file = GrowingFile(tmp_path / "a.txt", "heading")
    file.append("one")
    file._file = FullFile(file._file, room)  # type: ignore[assignment]
    with pytest.raises(OutputError, match="No space left"):
        file.replace_from(0, ["first", "second", "third", "fourth"])
    lines = (tmp_path / "a.txt.partial").read_text().splitlines(keepends=True)
    expected = ["heading\n", "first\n", "second\n", "third\n", "fourth\n"]
    assert lines == expected[: len(lines)]
    assert len(file) == len(lines) - 1
    assert sum(map(len, expected[: len(lines) + 1])) > room
    file.finish()
    assert (tmp_path / "a.txt").read_text().splitlines(keepends=True) == lines


def test_reserved_space_takes_a_file(tmp_path: Path) -> None:
    space = ReservedSpace(tmp_path)
    if not space.write(tmp_path / "a", tmp_path / "a.partial", b"one"):
        pytest.skip("this file system has no files without names")
    assert space.write(tmp_path / "a", tmp_path / "a.partial", b"two")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a", b"two")]
    space.close()
    assert not space.write(tmp_path / "a", tmp_path / "a.partial", b"three")


def test_the_summary_is_written_on_a_full_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = RunFolder(tmp_path / "out", "")
    folder.write_summary({"frames": 0})

    def full(path: Path, data: bytes) -> int:
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    try:
        folder.write_summary({"frames": 7})
    except OutputError:
        pytest.skip("this file system has no files without names")
    finally:
        folder.close()
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == {"frames": 7}
    assert not (tmp_path / "out" / "summary.json.partial").exists()


def test_a_run_into_a_limit_of_sizes_keeps_whole_lines_and_says_so(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    """A limit of 2 kB for each file, as a quota; the summary is larger than that."""
    out = tmp_path / "out"
    command = f"ulimit -f 2; exec {VO} run {synthetic_stereo} -o {out} --config fast --quiet"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=120)
    assert result.returncode == 1
    lines = result.stderr.splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ") and "File too large" in lines[0]
    names = {path.name for path in out.iterdir()}
    assert names <= set(RESULTS)
    for name in names - {"summary.json", "config.yaml"}:
        text = (out / name).read_text()
        assert text.endswith("\n")
    assert 2 <= len(read_tum(out / "trajectory.tum")) < 30


def test_space_for_the_path_is_kept_from_recordings(synthetic_stereo: Path, tmp_path: Path) -> None:
    """A disk with 100 kB left, which the recordings beside the results would fill."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=100k", "none", str(disk)]).returncode:
        pytest.skip("file systems cannot be mounted here")
    try:
        out = disk / "out"
        command = [VO, "run", synthetic_stereo, "-o", out, "--config", "fast", "--quiet"]
        command += ["--rrd", disk / "a.rrd", "--mcap", disk / "a.mcap", "--ply", disk / "a.ply"]
        result = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert "No space left" in result.stderr
        assert "Traceback" not in result.stderr
        summary = json.loads((out / "summary.json").read_text())
        path = read_tum(out / "trajectory.tum")
        assert summary["status"] == "finished" and summary["frames"] == len(path) == 30
    finally:
        subprocess.run(["umount", str(disk)], check=True)
