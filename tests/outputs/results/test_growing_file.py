from __future__ import annotations

from pathlib import Path

import pytest

from vo.base.errors import OutputError
from vo.outputs.results.growing_file import GrowingFile


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.txt"


def partial(path: Path) -> str:
    return path.with_name("a.txt.partial").read_text(encoding="utf-8")


def test_each_line_is_written_immediately(path: Path) -> None:
    file = GrowingFile(path, "heading")
    assert partial(path) == "heading\n"
    file.append("one")
    file.append("two")
    assert partial(path) == "heading\none\ntwo\n"
    assert len(file) == 2
    assert not path.exists()
    file.close()


@pytest.mark.parametrize("new", [[], ["longer than before"], ["x"], ["x", "y", "z", "ü"]])
@pytest.mark.parametrize("row", [0, 1, 2, 3])
@pytest.mark.parametrize("heading", ["", "heading"])
def test_replaces_the_last_rows(path: Path, new: list[str], row: int, heading: str) -> None:
    file = GrowingFile(path, heading)
    old = ["one", "two", "three"]
    for line in old:
        file.append(line)
    file.replace_from(row, new)
    file.append("last")
    expected = [heading] * bool(heading) + old[:row] + new + ["last"]
    assert partial(path).splitlines() == expected
    assert len(file) == row + len(new) + 1
    file.close()


def test_finish_gives_the_final_name(path: Path) -> None:
    file = GrowingFile(path)
    file.append("one")
    file.finish()
    assert path.read_text(encoding="utf-8") == "one\n"
    assert [p.name for p in path.parent.iterdir()] == ["a.txt"]


def test_the_error_contains_the_path_and_the_reason(path: Path) -> None:
    with pytest.raises(OutputError, match="missing/a.txt cannot be written: No such file"):
        GrowingFile(path.parent / "missing" / "a.txt")


def test_a_full_disk_is_an_output_error() -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full here")
    file = GrowingFile.__new__(GrowingFile)
    file._path, file._offsets, file._file = full, [0], full.open("wb", buffering=0)
    file._make_room = lambda: False
    with pytest.raises(OutputError, match="No space left"):
        file.append("one")
    file.close()
