"""The folder where machine code is kept from run to run."""

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


def place_of(name: str, fingerprint: str, types: str) -> Path:
    """Where the machine code of a function for some types of arguments belongs."""
    made_for = hashlib.sha256(f"{machine_code.maker()}\n{types}".encode()).hexdigest()
    return folder() / f"{name}-{made_for[:16]}-{fingerprint[:16]}.bin"


def load(place: Path) -> MachineCode | None:
    """What was kept; None if there is none, or it is damaged."""
    try:
        data = place.read_bytes()
    except OSError:
        return None
    digest, content = data[:32], data[32:]
    if hashlib.sha256(content).digest() != digest:
        return None
    return MachineCode(*pickle.loads(content))  # our own file, in our own folder


def save(place: Path, code: MachineCode) -> None:
    """Keep it, in place of what older versions of the function had become, if the disk allows."""
    content = pickle.dumps(tuple(code))
    outdated = place.name.rpartition("-")[0]
    new = place.with_suffix(f".{os.getpid()}")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        new.write_bytes(hashlib.sha256(content).digest() + content)
        new.replace(place)
        for other in place.parent.glob(f"{outdated}-*"):
            if other != place:
                other.unlink(missing_ok=True)
    except OSError as error:
        _log.info("machine code cannot be kept: %s", error)
        with suppress(OSError):
            new.unlink(missing_ok=True)


@contextmanager
def locked(place: Path) -> Iterator[None]:
    """Keep other processes from compiling the same function at the same time, if the disk allows.

    Only on systems that have `fcntl`.
    """
    lock, file = place.with_suffix(".lock"), None
    with suppress(OSError, ImportError):
        import fcntl

        place.parent.mkdir(parents=True, exist_ok=True)
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
