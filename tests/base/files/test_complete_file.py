"""Files that appear when they are complete."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from vo.base.files.complete_file import complete_file


def test_a_file_appears_at_the_end_in_place_of_the_old_one_also_through_a_link(
    tmp_path: Path,
) -> None:
    (tmp_path / "a").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "a")
    with complete_file(tmp_path / "link") as file:
        file.write(b"new")
        file.flush()
        assert (tmp_path / "a").read_text() == "old"
    assert (tmp_path / "a").read_text() == "new"
    assert sorted(os.listdir(tmp_path)) == ["a", "link"]
    assert (tmp_path / "link").is_symlink()


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_an_interrupted_file_leaves_the_old_one_and_nothing_else(
    error: type[BaseException], tmp_path: Path
) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(error), complete_file(tmp_path / "a") as file:
        file.write(b"new")
        raise error
    assert (tmp_path / "a").read_text() == "old"
    assert os.listdir(tmp_path) == ["a"]


def test_a_device_is_written_to() -> None:
    with complete_file(Path(os.devnull)) as file:
        file.write(b"new")
    assert not Path(os.devnull).is_file()
