from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from pathlib import Path

from vo.outputs.results.environment import _PACKAGES, peak_rss_mb, versions

PRINT_PEAK = "from vo.outputs.results.environment import peak_rss_mb; print(peak_rss_mb())"
PARENT = (
    "import subprocess, sys; big = bytearray(b'x') * (400 << 20); "
    f"{PRINT_PEAK}; sys.stdout.flush(); "
    "subprocess.run([sys.executable, '-c', sys.argv[1]], check=True)"
)


def test_peak_memory_excludes_the_parent_process() -> None:
    command = [sys.executable, "-c", PARENT, PRINT_PEAK]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    parent, child = map(float, done.stdout.split())
    assert 400 < parent < 600
    assert 5 < child < 200


def test_released_memory_counts_towards_the_peak() -> None:
    code = f"big = bytearray(b'x') * (200 << 20); del big; {PRINT_PEAK}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 200 < float(done.stdout) < 400


def test_the_peak_never_decreases() -> None:
    before = peak_rss_mb()
    assert peak_rss_mb() >= before > 5


def test_versions_are_those_of_the_installed_packages() -> None:
    found = versions()
    for name in ("numpy", "opencv"):
        assert found[name] == importlib.metadata.version(_PACKAGES[name])
    assert found["python"] == ".".join(map(str, sys.version_info[:3]))


def test_a_run_does_not_load_slow_modules(synthetic_stereo: Path, tmp_path: Path) -> None:
    code = "import sys; from vo.cli.entry import main; main()"
    slow = "{'importlib.metadata', 'numpy.ma'}"  # the latter by numpy.median and numpy.unique
    shown = f"import atexit; atexit.register(lambda: print({slow} & {{*sys.modules}}))"
    command = ["run", synthetic_stereo, "-o", tmp_path, "--end", "2", "-q"]
    done = subprocess.run(
        [sys.executable, "-c", code.replace("; ", f"; {shown}; ", 1), *command],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "set()\n"
