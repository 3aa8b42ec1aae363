"""Environment of a run: versions of its dependencies, its memory and age."""

from __future__ import annotations

import os
import re
import resource
import sys
import time
from functools import cache
from pathlib import Path

from vo.base.version import __version__

_PACKAGES = {
    "opencv": "opencv-python-headless",
    "gtsam": "gtsam",
    "numpy": "numpy",
    "numba": "numba",
}


def peak_rss_mb() -> float:
    """Peak memory of this process so far.

    On Linux, `ru_maxrss` includes the peak of the parent process, so it is read from /proc.
    Elsewhere `ru_maxrss` is in KiB, on macOS in bytes.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        found = re.search(r"^VmHWM:\s+(\d+) kB", status.read_text("utf-8"), re.MULTILINE)
        if found:
            return int(found[1]) / 2**10
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def process_age_s() -> float | None:
    """Seconds since this process was started, to a hundredth; None without /proc."""
    stat = Path("/proc/self/stat")
    if not stat.is_file():
        return None
    fields = stat.read_text("utf-8").rpartition(")")[2].split()  # the name may contain spaces
    started_s = int(fields[19]) / os.sysconf("SC_CLK_TCK")
    return time.clock_gettime(time.CLOCK_BOOTTIME) - started_s


@cache
def versions() -> dict[str, str]:
    """Versions of Python, this package and the libraries that affect results."""
    found = {"python": ".".join(map(str, sys.version_info[:3])), "vo": __version__}
    return found | {name: _version(package) for name, package in _PACKAGES.items()}


def _version(package: str) -> str:
    """By the name of the folder that its installer left; `importlib.metadata` takes 10 ms."""
    stem = package.replace("-", "_")
    for name in _installed():
        if name.startswith(f"{stem}-"):
            return name.removeprefix(f"{stem}-").removesuffix(".dist-info")
    from importlib.metadata import PackageNotFoundError, version  # other installers

    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


@cache
def _installed() -> list[str]:
    """Names of the folders that installers left, in the order in which packages are found."""
    found = []
    for folder in filter(os.path.isdir, sys.path):
        found += [name for name in os.listdir(folder) if name.endswith(".dist-info")]
    return found
