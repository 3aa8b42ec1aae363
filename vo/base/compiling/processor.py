"""One instruction set for all processors that support it, so that results have the same bits.

The order of additions in a sum depends on the vector length of the processor, in OpenBLAS and in
compiled code that may reorder them. Both are set to the AVX2 of 2013; on small matrices and patches
longer vectors bring no measurable gain.
"""

from __future__ import annotations

import os
from collections.abc import MutableMapping
from contextlib import suppress
from pathlib import Path

_INFO = Path("/proc/cpuinfo")
# Flags in cpuinfo of the extensions that make up x86-64-v3.
_NEEDED = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
# One entry for each library; they are independent of each other.
_SETTINGS = (
    {"OPENBLAS_CORETYPE": "Haswell"},
    {
        "NUMBA_CPU_NAME": "x86-64-v3",
        "NUMBA_CPU_FEATURES": "",  # those of the named processor, instead of all of this one
    },
)


def use_common_instructions(
    environment: MutableMapping[str, str] = os.environ, info: Path = _INFO
) -> None:
    """Set it for this process and its children; call it before numpy is imported.

    Nothing changes for a library whose variables are set already, or on a processor without AVX2.
    """
    if not _flags(info) >= _NEEDED:
        return
    for settings in _SETTINGS:
        if not any(name in environment for name in settings):
            environment.update(settings)


def has_common_instructions() -> bool:
    """Whether code is compiled for them."""
    settings = _SETTINGS[1]
    return all(os.environ.get(name) == value for name, value in settings.items())


def _flags(info: Path) -> set[str]:
    """Flags of the first processor; all of a machine are alike."""
    with suppress(OSError), info.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            name, _, value = line.partition(":")
            if name.strip() == "flags":
                return set(value.split())
    return set()
