"""The folder where machine code is kept from run to run."""

from __future__ import annotations

import hashlib
import logging
import os
import pickle
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from vo.compiling import machine_code
from vo.compiling.machine_code import MachineCode

_log = logging.getLogger(__name__)


def place_of(name: str, fingerprint: str, types: str) -> Path:
    """Where the machine code of a function for some types of arguments belongs."""
    made_for = hashlib.sha256(f"{machine_code.maker()}\n{types}".encode()).hexdigest()
    return _folder() / f"{name}-{made_for[:16]}-{fingerprint[:16]}.bin"


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


@lru_cache(maxsize=1)
def _folder() -> Path:
    """Where numba is told to keep its own, beside this module, or the user's cache."""
    told = os.environ.get("NUMBA_CACHE_DIR")
    if told:
        return Path(told) / "vo"
    beside = Path(__file__).parent / "__pycache__"
    with suppress(OSError):
        beside.mkdir(exist_ok=True)
    if os.access(beside, os.W_OK):
        return beside
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(cache) / "vo" / "compiled" if os.path.isabs(cache) else beside
