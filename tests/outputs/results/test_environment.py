from __future__ import annotations

import subprocess
import sys

from vo.outputs.results.environment import peak_rss_mb

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
