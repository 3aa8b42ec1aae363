"""Distributions that `visual-odometry` requires, directly or not, from what is installed here."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, distribution

from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

DISTRIBUTION = "visual-odometry"
CAMERAS = ("realsense", "oak")
"""Extras that are not in `all`, nor installed for tests."""

EXTRAS_OF_MODULES = {"pyrealsense2": "realsense", "depthai": "oak", "pyzed": None}
"""Packages of cameras; None where no extra installs them."""


def required(extras: tuple[str, ...]) -> dict[str, str]:
    """Canonical names and versions of all distributions that this one requires with some extras.

    Raises:
        PackageNotFoundError: one of them is not installed.
    """
    found: dict[str, str] = {}
    visited: set[tuple[str, tuple[str, ...]]] = set()
    waiting = [(DISTRIBUTION, extras)]
    while waiting:
        name, wanted = waiting.pop()
        if (name, wanted) in visited:
            continue
        visited.add((name, wanted))
        found[name] = distribution(name).version
        waiting += _direct(name, wanted)
    del found[DISTRIBUTION]
    return dict(sorted(found.items()))


def _direct(name: str, extras: tuple[str, ...]) -> list[tuple[str, tuple[str, ...]]]:
    """Requirements of one distribution for this system and version of Python."""
    here = {str(key): str(value) for key, value in default_environment().items()}
    environments = [{**here, "extra": extra} for extra in ("", *extras)]
    return [
        (canonicalize_name(each.name), tuple(sorted(each.extras)))
        for each in map(Requirement, distribution(name).requires or [])
        if each.marker is None or any(each.marker.evaluate(e) for e in environments)
    ]


def direct(extra: str) -> set[str]:
    """Canonical names of the distributions that an extra requires itself; "" for the core."""
    others = {name for name, _ in _direct(DISTRIBUTION, ())} if extra else set()
    return {name for name, _ in _direct(DISTRIBUTION, (extra,) if extra else ())} - others


def missing() -> str | None:
    """Name of a required distribution that is not installed here; None if all are."""
    try:
        required(("dev",))
    except PackageNotFoundError as error:
        return str(error.name)
    return None


def licence(name: str) -> str:
    """The licence that a distribution declares, as an SPDX expression where it has one."""
    data = distribution(name).metadata
    if "License-Expression" in data:
        return str(data["License-Expression"])
    classifiers = [
        line.rpartition(" :: ")[2]
        for line in data.get_all("Classifier", [])
        if line.startswith("License :: ") and line != "License :: OSI Approved"
    ]
    text = str(data["License"]).strip().splitlines()[0] if "License" in data else ""
    short = text if 0 < len(text) <= 40 else ""
    return " / ".join(classifiers) or short or "see its files"


def home_page(name: str) -> str:
    """Address of a distribution's project, empty if it gives none."""
    data = distribution(name).metadata
    if "Home-page" in data and data["Home-page"] not in ("", "UNKNOWN"):
        return str(data["Home-page"])
    pages = dict(re.split(r",\s*", line, maxsplit=1) for line in data.get_all("Project-URL", []))
    lower = {label.lower(): page for label, page in pages.items()}
    for label in ("homepage", "home", "source", "source code", "repository", "github"):
        if label in lower:
            return lower[label]
    return next(iter(pages.values()), "")
