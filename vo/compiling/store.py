"""Cache of machine code on disk."""

from __future__ import annotations

import hashlib
import logging
import os
import pickle
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

from vo.compiling import machine_code
from vo.compiling.machine_code import MachineCode

_log = logging.getLogger(__name__)


def path_of(name: str, fingerprint: str, types: str) -> Path:
    """File of the machine code of a function for some types of arguments."""
    made_for = hashlib.sha256(f"{machine_code.toolchain()}\n{types}".encode()).hexdigest()
    return folder() / f"{name}-{made_for[:16]}-{fingerprint[:16]}.bin"


def load(path: Path) -> MachineCode | None:
    """Content of a file; None if it is missing or damaged."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    digest, content = data[:32], data[32:]
    if hashlib.sha256(content).digest() != digest:
        return None
    return MachineCode(*pickle.loads(content))  # our own file, in our own folder


def save(path: Path, code: MachineCode) -> None:
    """Save machine code and remove that of older versions of the function.

    A folder that cannot be written to is no error.
    """
    content = pickle.dumps(tuple(code))
    outdated = path.name.rpartition("-")[0]
    new = path.with_suffix(f".{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        new.write_bytes(hashlib.sha256(content).digest() + content)
        new.replace(path)
        for other in path.parent.glob(f"{outdated}-*"):
            if other != path:
                other.unlink(missing_ok=True)
    except OSError as error:
        _log.info("machine code cannot be saved: %s", error)
        with suppress(OSError):
            new.unlink(missing_ok=True)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep other processes from compiling the same function at the same time, if the disk allows.

    Only on systems that have `fcntl`.
    """
    lock, file = path.with_suffix(".lock"), None
    with suppress(OSError, ImportError):
        import fcntl

        path.parent.mkdir(parents=True, exist_ok=True)
        file = lock.open("w")
        fcntl.flock(file, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if file is not None:
            with suppress(OSError):
                lock.unlink(missing_ok=True)
            file.close()


@lru_cache(maxsize=1)
def folder() -> Path:
    """NUMBA_CACHE_DIR if it is set, else beside this module, else the user's cache folder."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given) / "vo"
    beside = Path(__file__).parent / "__pycache__"
    with suppress(OSError):
        beside.mkdir(exist_ok=True)
    if os.access(beside, os.W_OK):
        return beside
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(cache) / "vo" / "compiled" if os.path.isabs(cache) else beside
