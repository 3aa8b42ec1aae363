"""One instruction set on all processors that have it, so that they all give the same bits.

Sums are added up in an order that suits the vectors of the processor: by OpenBLAS, and by compiled
code that may reorder them. Both are told to do as on a processor of 2013; on small matrices and
patches longer vectors gain nothing that could be measured.
"""

from __future__ import annotations

import os
from collections.abc import MutableMapping
from contextlib import suppress
from pathlib import Path

_INFO = Path("/proc/cpuinfo")
# What x86-64-v3 has beyond the older versions, as Linux calls it.
_NEEDED = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
# Of libraries that know nothing of each other: what is asked for of one does not concern the other.
_SETTINGS = (
    {"OPENBLAS_CORETYPE": "Haswell"},
    {
        "NUMBA_CPU_NAME": "x86-64-v3",
        "NUMBA_CPU_FEATURES": "",  # those that the name stands for, instead of all that are there
    },
)


def use_common_instructions(
    environment: MutableMapping[str, str] = os.environ, info: Path = _INFO
) -> None:
    """Settle it for this process and its children; to be called before numpy is imported.

    Nothing changes for a library that is told something already, nor on an older processor or one
    of another kind.
    """
    if not _flags(info) >= _NEEDED:
        return
    for settings in _SETTINGS:
        if not any(name in environment for name in settings):
            environment.update(settings)


def _flags(info: Path) -> set[str]:
    """What the first processor can do; all of a machine can do the same."""
    with suppress(OSError), info.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            name, _, value = line.partition(":")
            if name.strip() == "flags":
                return set(value.split())
    return set()
