"""What a run ran on: versions of what it depends on, and the memory that it took."""

from __future__ import annotations

import os
import re
import resource
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = {
    "vo": "vo",
    "opencv": "opencv-python-headless",
    "gtsam": "gtsam",
    "numpy": "numpy",
    "numba": "numba",
}


def peak_rss_mb() -> float:
    """Largest memory of this process so far.

    Linux keeps the peak of whoever started this process in `ru_maxrss`; its own stands in
    /proc. Elsewhere the system counts KiB, on macOS bytes.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        found = re.search(r"^VmHWM:\s+(\d+) kB", status.read_text("utf-8"), re.MULTILINE)
        if found:
            return int(found[1]) / 2**10
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def process_age_s() -> float | None:
    """Seconds since this process was started, to a hundredth; None where /proc does not tell."""
    stat = Path("/proc/self/stat")
    if not stat.is_file():
        return None
    fields = stat.read_text("utf-8").rpartition(")")[2].split()  # the name may hold anything
    started_s = int(fields[19]) / os.sysconf("SC_CLK_TCK")
    return time.clock_gettime(time.CLOCK_BOOTTIME) - started_s


def versions() -> dict[str, str]:
    """Of Python, this package and the libraries that a result depends on."""
    found = {"python": ".".join(map(str, sys.version_info[:3]))}
    for name, package in _PACKAGES.items():
        try:
            found[name] = version(package)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
