"""The kernels and threads of an OpenBLAS that is loaded already.

OpenBLAS chooses its kernels when it is loaded, with numpy or OpenCV. A program that imports these
before `vo` would get those of its processor, and results that differ from those of `vo run` in the
last bits. So do results of several threads.
"""

from __future__ import annotations

import ctypes
import os
from contextlib import suppress
from pathlib import Path

_MAPS = Path("/proc/self/maps")
_VARIABLE = "OPENBLAS_CORETYPE"
_THREADS = "OPENBLAS_NUM_THREADS"
# By the name of the build: OpenCV's, and numpy's with 64-bit integers.
_SET_THREADS = "openblas_set_num_threads", "scipy_openblas_set_num_threads64_"
_OWNERS = ("numpy.libs", "opencv_")  # folders of the libraries that this project computes with


def choose_kernels_again(maps: Path = _MAPS) -> list[str]:
    """Make every loaded OpenBLAS use the kernels that OPENBLAS_CORETYPE names.

    Nothing is done without that variable, outside of Linux, and for other builds. No other thread
    may be computing with it meanwhile.

    Returns:
        Paths of the libraries that have changed their kernels.
    """
    wanted = os.environ.get(_VARIABLE)
    if not wanted:
        return []
    changed = []
    for path in _loaded(maps):
        library = ctypes.CDLL(path)
        try:
            name, end, begin = (
                getattr(library, function)
                for function in (
                    "gotoblas_corename",
                    "gotoblas_dynamic_quit",
                    "gotoblas_dynamic_init",
                )
            )
        except AttributeError:  # built for one processor
            continue
        name.restype = ctypes.c_char_p
        if name().decode().lower() == wanted.lower():
            continue
        end()
        begin()
        changed.append(path)
    return changed


def use_one_thread(maps: Path = _MAPS) -> None:
    """Make every loaded OpenBLAS compute in one thread, unless OPENBLAS_NUM_THREADS is set.

    Nothing is done outside of Linux.
    """
    if _THREADS in os.environ:
        return
    for path in _loaded(maps):
        library = ctypes.CDLL(path)
        for name in _SET_THREADS:
            with suppress(AttributeError):
                getattr(library, name)(1)


def _loaded(maps: Path) -> list[str]:
    """Paths of the libraries in this process."""
    paths: list[str] = []
    with suppress(OSError):
        lines = maps.read_text(encoding="utf-8", errors="replace").splitlines()
        fields = [line.split(maxsplit=5) for line in lines]
        paths = [each[5] for each in fields if len(each) == 6 and "openblas" in each[5]]
    return [path for path in dict.fromkeys(paths) if any(owner in path for owner in _OWNERS)]
