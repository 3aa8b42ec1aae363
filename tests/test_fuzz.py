"""Random damage to inputs of all kinds ends with a line, as `scripts/fuzz` counts it."""

from __future__ import annotations

import importlib
import json
import random
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"


@pytest.fixture
def fuzz() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        yield importlib.import_module("fuzz")
    for name in ("fuzz", "fuzz_samples", "fuzz_mutations"):
        sys.modules.pop(name, None)


def test_no_damage_is_worse_than_an_error() -> None:
    done = subprocess.run(
        [sys.executable, SCRIPTS / "fuzz.py", "--count", "20"],
        capture_output=True,
        text=True,
        check=False,
        timeout=1200,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith("| all | ")
    assert done.stdout.splitlines()[-1].endswith("| 0 | 0 | 0 |")


@pytest.mark.parametrize(
    ("error", "outcome"),
    [(None, "read"), (KeyError("a"), "traceback"), (MemoryError(), "memory")],
)
def test_outcomes(fuzz: ModuleType, error: Exception | None, outcome: str) -> None:
    def read(reader: str, path: Path, number: int) -> str:
        if error is not None:
            raise error
        return "read"

    assert fuzz._result(SimpleNamespace(read=read), "recording", "/a", 0).outcome == outcome


def test_a_process_that_ends_is_counted_and_replaced(fuzz: ModuleType, tmp_path: Path) -> None:
    worker = fuzz._Worker()
    worker._start = lambda: subprocess.Popen(
        [sys.executable, "-c", "import os; input(); os.abort()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    for _ in range(2):
        result = worker.read("config", tmp_path, 0)
        assert result.outcome == "traceback" and "status -6" in result.line


def test_a_process_that_waits_is_a_hang(fuzz: ModuleType, tmp_path: Path) -> None:
    fuzz._TIMEOUT_S = 0.2
    worker = fuzz._Worker()
    worker._start = lambda: subprocess.Popen(
        [sys.executable, "-c", "import time; time.sleep(60)"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert worker.read("config", tmp_path, 0).outcome == "hang"


def test_damage_follows_the_seed(fuzz: ModuleType, tmp_path: Path) -> None:
    mutations = importlib.import_module("fuzz_mutations")
    original = json.dumps({"a": [1.5, {"b": "text"}], "c": 3}).encode()
    found = []
    for seed in (1, 1, *range(2, 40)):
        file = tmp_path / "a.json"
        file.write_bytes(original)
        mutations.damage(file, random.Random(seed))
        found.append(file.read_bytes())
    assert found[0] == found[1]
    assert len(set(found)) > 25


def test_the_table_has_a_row_for_each_group(fuzz: ModuleType) -> None:
    counts = {
        "kitti": Counter({"read": 2}),
        "kitti tables": Counter({"error line": 1, "hang": 1}),
        "config": Counter({"read": 3}),
    }
    rows = fuzz.table(counts).splitlines()[2:]
    assert rows == [
        "| kitti | 2 | 4 | 1 | 2 | 0 | 1 | 0 |",
        "| config | 1 | 3 | 0 | 3 | 0 | 0 | 0 |",
        "| all | 3 | 7 | 1 | 5 | 0 | 1 | 0 |",
    ]
