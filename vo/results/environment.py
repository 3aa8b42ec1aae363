"""What a run ran on: versions of what it depends on, and the memory that it took."""

from __future__ import annotations

import resource
import sys
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = {
    "vo": "vo",
    "opencv": "opencv-python-headless",
    "gtsam": "gtsam",
    "numpy": "numpy",
    "numba": "numba",
}


def peak_rss_mb() -> float:
    """Largest memory of this process so far: the system counts KiB, on macOS bytes."""
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
