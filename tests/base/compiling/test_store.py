"""Machine code is loaded only from files that nobody else could have written."""

from __future__ import annotations

import logging
import os
import pickle
import stat
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vo.base.compiling import machine_code, store
from vo.base.compiling.function import compiled, compiled_here

_OTHER_USER = 12345
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty NUMBA_CACHE_DIR that everybody can write to."""
    tmp_path.chmod(0o777)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    store.folder.cache_clear()
    yield tmp_path
    monkeypatch.undo()
    store.folder.cache_clear()


def _area(a: Any, b: Any) -> Any:
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b
    return total


def _is_compiled_again(arguments: tuple[Any, ...] = (np.arange(4.0), 2.0)) -> bool:
    """Whether a call compiles, instead of loading the machine code."""
    before = len(compiled_here())
    assert compiled(_area)(*arguments) == 12.0
    return len(compiled_here()) > before


def _saved(shared: Path) -> Path:
    """The file of a function that was compiled."""
    assert _is_compiled_again()
    (file,) = (shared / "vo").glob("*.bin")
    assert not _is_compiled_again()
    return file


def test_files_are_no_pickles_and_the_folder_is_closed_to_others(shared: Path) -> None:
    file = _saved(shared)
    assert not stat.S_IMODE((shared / "vo").stat().st_mode) & 0o022
    assert not stat.S_IMODE(file.stat().st_mode) & 0o022
    assert file.read_bytes()[32:].startswith(b"vo machine code 2\n")
    with pytest.raises(pickle.UnpicklingError):
        pickle.loads(file.read_bytes()[32:])
    assert {f.suffix for f in (shared / "vo").iterdir()} == {".bin"}  # nothing temporary is left


def _to_another_user(file: Path) -> None:
    os.chown(file, _OTHER_USER, -1)


def _to_a_link(file: Path) -> None:
    file.rename(file.with_suffix(".elsewhere"))
    file.symlink_to(file.with_suffix(".elsewhere"))


def _to_a_pipe(file: Path) -> None:
    file.unlink()
    os.mkfifo(file)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(_to_another_user, marks=needs_root),
        lambda file: file.chmod(0o666),
        lambda file: file.chmod(0o660),
        _to_a_link,
        _to_a_pipe,
    ],
    ids=["another user's", "writable by all", "writable by a group", "a link", "a pipe"],
)
def test_a_file_that_others_could_have_written_is_not_loaded(
    shared: Path, change: Callable[[Path], None]
) -> None:
    file = _saved(shared)
    change(file)
    assert _is_compiled_again()
    assert not file.is_symlink() and file.is_file()
    assert not _is_compiled_again()  # it was replaced


@needs_root
def test_a_folder_of_another_user_is_not_used(
    shared: Path, caplog: pytest.LogCaptureFixture
) -> None:
    planted = _saved(shared)
    os.chown(planted.parent, _OTHER_USER, -1)
    before = planted.read_bytes()
    store.folder.cache_clear()
    with caplog.at_level(logging.INFO, "vo.base.compiling.store"):
        assert store.folder() != planted.parent
        store.folder()
    (line,) = (r.getMessage() for r in caplog.records)
    assert line.endswith(f"is not used: {planted.parent} belongs to another user")
    assert planted.read_bytes() == before


def test_a_link_in_place_of_the_folder_is_not_followed(shared: Path) -> None:
    (shared / "elsewhere").mkdir()
    (shared / "vo").symlink_to(shared / "elsewhere")
    assert store.folder() != shared / "vo"
    compiled(_area)(np.arange(4.0), 2.0)
    assert not list((shared / "elsewhere").iterdir())


def test_an_own_folder_is_closed_to_others(shared: Path) -> None:
    file = _saved(shared)
    file.parent.chmod(0o777)
    store.folder.cache_clear()
    assert store.folder() == file.parent
    assert stat.S_IMODE(file.parent.stat().st_mode) == 0o755


@needs_root
def test_another_user_reads_what_root_has_compiled(shared: Path) -> None:
    file = _saved(shared)
    assert stat.S_IMODE(file.parent.stat().st_mode) == 0o755
    assert stat.S_IMODE(file.stat().st_mode) == 0o644
    reader = os.fork()
    if reader == 0:
        os.chdir(file.parent)  # the folders above it are closed to others
        os.setuid(_OTHER_USER)
        os._exit(store.load(Path(file.name)) is None)
    assert os.waitpid(reader, 0)[1] == 0


def test_other_constants_than_dtypes_are_not_saved(shared: Path) -> None:
    code = machine_code.MachineCode(b"code", "entry", "environment", [object()])
    store.save(shared / "vo" / "name-a-b.bin", code)
    assert not (shared / "vo").exists()


@pytest.mark.parametrize("constants", [[], [np.dtype(bool), np.dtype(">f4"), np.dtype(np.uint8)]])
def test_a_file_gives_back_what_was_saved(shared: Path, constants: list[Any]) -> None:
    code = machine_code.MachineCode(bytes(range(256)), "entry", "environment", constants)
    path = shared / "vo" / "name-a-b.bin"
    store.save(path, code)
    assert store.load(path) == code
    path.rename(path.with_name("other-a-b.bin"))  # of another function
    assert store.load(path.with_name("other-a-b.bin")) is None


def test_versions_share_a_folder_and_only_the_oldest_are_removed(shared: Path) -> None:
    code = machine_code.MachineCode(b"code", "entry", "environment", [])
    paths = [shared / "vo" / f"name-a-{version:02}.bin" for version in range(10)]
    other = shared / "vo" / "name_of_another-a-00.bin"
    store.save(other, code)
    for age, path in enumerate(paths):
        store.save(path, code)
        os.utime(path, ns=(age, age))
    assert store.load(paths[-3]) == code  # an environment beside this one compiles nothing
    assert [path for path in paths if path.exists()] == paths[2:]
    assert other.exists()


@needs_root
@pytest.mark.parametrize("is_full", [False, True])
def test_a_user_whose_home_is_read_only_has_a_folder_for_temporary_files(
    is_full: bool, shared: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home, temporary = shared / "home", shared / "tmp"
    home.mkdir(mode=0o755)
    temporary.mkdir()
    temporary.chmod(0o555 if is_full else 0o1777)
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    for folder in shared.parents:  # pytest's are private
        if folder.stat().st_mode & 0o001:
            break
        folder.chmod(0o755)
    wanted = store._NOWHERE if is_full else temporary / f"vo-compiled-{_OTHER_USER}"
    child = os.fork()
    if child == 0:
        os.setuid(_OTHER_USER)
        store.folder.cache_clear()
        os._exit(store.folder() != wanted)
    assert os.waitpid(child, 0)[1] == 0
