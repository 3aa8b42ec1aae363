"""Functions compiled once, and loaded without numba by every process after that."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from collections import namedtuple
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from vo.base.compiling import machine_code, store
from vo.base.compiling.fingerprint import fingerprint
from vo.base.compiling.function import NO_REFCOUNT, Intrinsic, compiled
from vo.base.compiling.signatures import describe

HELPER = """
from vo.base.compiling.fingerprint import fingerprint
from vo.base.compiling.function import compiled

SHIFT = 2.0

@compiled
def half(x):
    return x / 2
"""
# What it prints: whether numba was loaded to get there, and three results.
MODULE = """
import sys
import numpy as np
from vo.base.compiling.fingerprint import fingerprint
from vo.base.compiling.function import Intrinsic, compiled
from vo_helper import SHIFT, half

_add_row = Intrinsic("vo.engine.backend.intrinsics", "add_row")

@compiled
def moved(values, by):
    result = np.empty_like(values)
    for i in range(len(values)):
        result[i] = half(values[i]) + by * SHIFT
    return result, len(values), (by, True)

@compiled(error_model="python")
def divided(a, b):
    return a / b

@compiled
def summed(left, right):
    block = np.zeros(8)
    _add_row(block, 0, left, 0, 1, right, 0)
    return block[7]

if __name__ == "__main__":
    import vo_module
    result, count, more = vo_module.moved(np.arange(3.0), 10)
    assert isinstance(count, int) and isinstance(result, np.ndarray)
    try:
        vo_module.divided(1.0, 0.0)
    except ZeroDivisionError:
        zero = "refused"
    numbers = vo_module.divided(1.0, 4.0), vo_module.summed(np.arange(3.0), np.arange(24.0))
    print("numba" in sys.modules and "numba.core.dispatcher" in sys.modules)
    print(result.tolist(), count, more, numbers, zero)
"""
RESULT = "[20.0, 20.5, 21.0] 3 (10, True) (0.25, 61.0) refused"


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of machine code, empty."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    store.folder.cache_clear()
    yield tmp_path / "vo"
    monkeypatch.undo()
    store.folder.cache_clear()


def program(folder: Path, module: str = MODULE, helper: str = HELPER) -> list[str]:
    """The lines that the module prints in a process of its own."""
    (folder / "vo_helper.py").write_text(helper, encoding="utf-8")
    (folder / "vo_module.py").write_text(module, encoding="utf-8")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, folder / "vo_module.py"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the module has been run, and its functions compiled."""
    folder = tmp_path_factory.mktemp("compiled")
    assert program(folder) == ["True", RESULT]
    return folder


@pytest.fixture
def folder(compiled_once: Path, tmp_path: Path) -> Path:
    """A copy of that folder."""
    shutil.copytree(compiled_once, tmp_path, dirs_exist_ok=True)
    return tmp_path


class Ring(NamedTuple):
    points: Any
    radius: Any


def area(a: Any, b: Any) -> Any:
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b
    return total


def test_the_second_process_does_without_numba(folder: Path) -> None:
    files = set((folder / "vo").iterdir())
    assert program(folder)[-1] == RESULT
    assert {f.name.partition("-")[0] for f in files} == {
        "vo_module.moved",
        "vo_module.divided",
        "vo_module.summed",
    }
    # Only the exception, of which the text is kept by numba, has it loaded.
    quiet = MODULE.replace("vo_module.divided(1.0, 0.0)", "raise ZeroDivisionError")
    assert program(folder, quiet) == ["False", RESULT]
    assert set((folder / "vo").iterdir()) == files


@pytest.mark.parametrize(
    ("module", "helper", "result"),
    [
        (MODULE, HELPER.replace("SHIFT = 2.0", "SHIFT = 3.0"), "[30.0, 30.5, 31.0]"),
        (MODULE, HELPER.replace("x / 2", "x / 4"), "[20.0, 20.25, 20.5]"),
        (MODULE.replace("by * SHIFT", "by"), HELPER, "[10.0, 10.5, 11.0]"),
    ],
    ids=["a constant of another module", "a function of another module", "the function itself"],
)
def test_what_has_changed_is_compiled_anew(
    folder: Path, module: str, helper: str, result: str
) -> None:
    before = {f.name for f in (folder / "vo").glob("vo_module.moved-*")}
    assert program(folder, module, helper)[-1].startswith(result)
    after = {f.name for f in (folder / "vo").glob("vo_module.moved-*")}
    assert len(before) == 1
    assert before < after  # an environment with the old one beside this one need not compile


def test_comments_and_lines_do_not_matter(folder: Path) -> None:
    module = MODULE.replace("    result = np", "    # half of it\n\n    result = np")
    module = module.replace("vo_module.divided(1.0, 0.0)", "raise ZeroDivisionError")
    assert program(folder, module) == ["False", RESULT]


def test_damaged_files_are_made_again(folder: Path) -> None:
    files = {f: f.stat().st_size for f in sorted((folder / "vo").iterdir())}
    cut, changed, emptied = files
    cut.write_bytes(cut.read_bytes()[:1000])
    data = changed.read_bytes()
    changed.write_bytes(data[:1000] + bytes([data[1000] ^ 1]) + data[1001:])
    emptied.write_bytes(b"")
    assert program(folder) == ["True", RESULT]
    assert {f: f.stat().st_size for f in (folder / "vo").iterdir()} == files


def test_nothing_is_kept_where_nothing_can_be_written(kept: Path) -> None:
    kept.write_text("a file where the folder should be", encoding="utf-8")
    assert compiled(area)(np.arange(4.0), 2.0) == 12.0
    assert kept.is_file()


def test_an_unknown_numba_keeps_what_it_compiles_itself(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine_code, "_SUPPORTED_VERSIONS", ("0.1.",))
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(kept.parent))
    machine_code.is_supported.cache_clear()
    try:
        assert compiled(area)(np.arange(4.0), 2.0) == 12.0
    finally:
        machine_code.is_supported.cache_clear()
    assert not kept.exists()
    assert list(kept.parent.rglob("test_compiled.area*.nbc"))


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int64, np.uint8, np.bool_])
@pytest.mark.parametrize("factor", [2, 2.5, True, np.float32(1.5), np.int32(3)])
def test_every_kind_of_argument_gives_what_python_gives(
    kept: Path, kind: type, factor: Any
) -> None:
    values = np.arange(8).astype(kind)
    function = compiled(area)
    assert function(values, factor) == area(values, factor)
    assert function(values[::2], factor) == area(values[::2], factor)
    assert function(values, factor) == area(values, factor)
    assert len(list(kept.iterdir())) == 2


def test_matrices_may_lie_either_way(kept: Path) -> None:
    @compiled
    def corner(matrix: Any) -> Any:
        return matrix[0, 1] + 10 * matrix[1, 0]

    matrix = np.arange(6.0).reshape(2, 3)
    for either in (matrix, np.asfortranarray(matrix), np.repeat(matrix, 2, axis=1)[:, ::2]):
        assert corner(either) == 31.0
    assert corner(matrix.T) == 13.0


def test_arrays_that_may_not_be_written_are_taken(kept: Path) -> None:
    values = np.arange(4.0)
    values.setflags(write=False)
    assert compiled(area)(values, 2.0) == 12.0
    assert describe(values) == "f8[1Cr]"


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (np.zeros((2, 3)), "f8[2C]"),
        (np.zeros((2, 3)).T, "f8[2F]"),
        (np.zeros((2, 4))[:, ::2], "f8[2A]"),
        (np.zeros(3, np.uint8), "u1[1C]"),
        ((1, 2.0, (True, np.float32(1))), "(i8 f8 (? f4))"),
        (Ring(np.zeros((3, 2)), 1.5), "Ring(points=f8[2C] radius=f8)"),
        (Ring(np.zeros((3, 2)), "wide"), None),
        (np.zeros(3, ">f8"), None),
        (np.zeros(3, "U1"), None),
        ((1, "text"), None),
        (None, None),
    ],
)
def test_words_for_kinds(value: Any, words: str | None) -> None:
    assert describe(value) == words


def test_named_tuples_are_taken_with_the_types_of_their_parts(kept: Path) -> None:
    @compiled
    def size(ring: Ring) -> Any:
        return ring.points[0] * ring.radius

    assert size(Ring(np.array([2.0, 3.0]), 1.5)) == 3.0
    assert size(Ring(np.array([2, 3]), 2)) == 4
    assert len(list(kept.iterdir())) == 2


def test_arguments_without_words_are_left_to_numba(kept: Path) -> None:
    @compiled
    def length(text: Any) -> Any:
        return len(text)

    assert length("four") == 4
    assert not kept.exists()


def test_arguments_go_by_position() -> None:
    with pytest.raises(TypeError, match="area takes no argument by name"):
        compiled(area)(np.arange(3.0), b=2.0)


def test_intrinsics_are_for_compiled_functions() -> None:
    with pytest.raises(TypeError, match="add_row can be called in compiled functions only"):
        Intrinsic("vo.engine.backend.intrinsics", "add_row")(1)


def test_threads_that_need_it_at_once_get_the_same(kept: Path) -> None:
    function, results = compiled(area), []
    threads = [
        threading.Thread(target=lambda: results.append(function(np.arange(4.0), 2.0)))
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [12.0] * 8
    assert len(list(kept.iterdir())) == 1


def test_the_fields_of_a_named_tuple_are_part_of_a_fingerprint() -> None:
    first, second = (namedtuple("Ring", names) for names in ("points radius", "radius points"))
    assert fingerprint((first,)) == fingerprint((namedtuple("Ring", "points radius"),))
    assert fingerprint((first,)) != fingerprint((second,))


def test_what_may_change_unnoticed_is_refused(kept: Path) -> None:
    @compiled
    def reads(values: Any) -> Any:
        return values[0] + len(_A_LIST)

    with pytest.raises(TypeError, match="compiled code refers to a list"):
        reads(np.arange(3.0))


_A_LIST = [1, 2, 3]


@compiled(**NO_REFCOUNT)
def _filled(rows: Any, result: Any) -> Any:
    for i in range(len(rows)):
        row = rows[i]
        result[i] = row[0] + row[-1]


def test_what_does_not_count_users_neither_frees_nor_keeps_arrays(kept: Path) -> None:
    @compiled
    def sums(rows: Any) -> Any:
        doubled = 2.0 * rows
        result = np.zeros(len(rows))
        for _ in range(3):
            _filled(doubled[1:], result[1:])
        return result

    rows = np.arange(12.0).reshape(4, 3)
    users = sys.getrefcount(rows)
    results = [sums(rows) for _ in range(1000)]
    assert sys.getrefcount(rows) == users
    assert all(r.tolist() == [0.0, 16.0, 28.0, 40.0] for r in results)
    assert len({sys.getrefcount(r) for r in results}) == 1


def test_a_run_does_without_numba(synthetic_stereo: Path, tmp_path: Path) -> None:
    program = (
        "import sys, atexit\n"
        "atexit.register(lambda: print('numba.core.dispatcher' in sys.modules))\n"
        "from vo.cli.entry import main\n"
        f"sys.argv = ['vo', 'run', {str(synthetic_stereo)!r}, '--end', '6', '-q', '--threads', '1',"
        f" '-o', {str(tmp_path / 'out')!r}]\n"
        "main()\n"
    )
    for _ in range(2):  # the first one may have to compile
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=300
        )
    assert done.stdout.splitlines()[-1] == "False"
