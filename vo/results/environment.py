"""What a run ran on: versions of what it depends on, and the memory that it took."""

from __future__ import annotations

import re
import resource
import sys
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


def versions() -> dict[str, str]:
    """Of Python, this package and the libraries that a result depends on."""
    found = {"python": ".".join(map(str, sys.version_info[:3]))}
    for name, package in _PACKAGES.items():
        try:
            found[name] = version(package)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
