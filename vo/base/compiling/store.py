"""Cache of machine code on disk.

Machine code runs with the rights of the user, so that it is only loaded from files that nobody
else could have written: those of this user or of root, in a folder of this user or of root, which
others cannot write to. The folder beside this module is as safe as the module itself.

A file holds the SHA-256 of its name and the rest (32 bytes), `_MAGIC`, the length of a header (4
bytes, little endian), the header in JSON (`entry`, `environment`, `constants`) and the object file.
A constant is a dtype in numpy's notation.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

import numpy as np

from vo.base.compiling import machine_code
from vo.base.compiling.machine_code import MachineCode

_log = logging.getLogger(__name__)
_MAGIC = b"vo machine code 2\n"
_DIGEST_BYTES = hashlib.sha256().digest_size
_MAX_BYTES = 64 * 2**20  # the largest function takes 0.1 MB
_KEPT = 8  # versions of a file: environments that share a folder must not compile in turn
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_NOWHERE = Path(os.devnull) / "vo"
_NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # nor a waiting pipe


def path_of(name: str, fingerprint: str, types: str) -> Path:
    """File of the machine code of a function for some types of arguments."""
    # The format counts as well: versions of this program may share a folder.
    about = f"{_MAGIC!r}{machine_code.toolchain()}\n{types}"
    made_for = hashlib.sha256(about.encode()).hexdigest()
    return folder() / f"{name}-{made_for[:16]}-{fingerprint[:16]}.bin"


def load(path: Path) -> MachineCode | None:
    """Content of a file; None if it is missing or damaged, or may be somebody else's."""
    try:
        with open(os.open(path, os.O_RDONLY | _NO_LINK), "rb") as file:
            info = os.fstat(file.fileno())
            if not _is_own_file(info, path):
                _log.info("%s is not used: others can write to it", path)
                return None
            data = file.read(min(info.st_size, _MAX_BYTES))
    except OSError:
        return None
    digest, content = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
    if _digest(path, content) != digest or not content.startswith(_MAGIC):
        return None
    begin = len(_MAGIC) + 4
    end = begin + int.from_bytes(content[len(_MAGIC) : begin], "little")
    header = json.loads(content[begin:end])
    constants = [np.dtype(name) for name in header["constants"]]
    return MachineCode(content[end:], header["entry"], header["environment"], constants)


def save(path: Path, code: MachineCode) -> None:
    """Save machine code and remove that of the oldest versions of the function.

    A folder that cannot be written to is no error, nor are constants other than dtypes, which
    cannot be saved.
    """
    if not all(isinstance(constant, np.dtype) for constant in code.constants):
        _log.info("machine code with other constants than dtypes is not saved: %s", path.name)
        return
    header = {
        "entry": code.entry,
        "environment": code.environment,
        "constants": [constant.str for constant in code.constants],
    }
    text = json.dumps(header).encode()
    content = _MAGIC + len(text).to_bytes(4, "little") + text + code.object_file
    function = path.name.rpartition("-")[0]
    try:
        create_folder()
        _write(path, _digest(path, content) + content)
        remove_oldest(f"{function}-*.bin")
    except OSError as error:
        _announce_loss(str(error) if path.parent != _NOWHERE else "no folder can be written to")


def remove_oldest(pattern: str) -> None:
    """Remove all but the newest files of the folder whose names match a pattern."""
    with suppress(FileNotFoundError):  # another process has removed one at the same time
        found = [(path.stat().st_mtime_ns, path) for path in folder().glob(pattern)]
        for _, path in sorted(found)[:-_KEPT]:
            path.unlink()


@lru_cache(maxsize=1)
def _announce_loss(reason: str) -> None:
    """Log, once per process, that nothing is kept."""
    _log.info(
        "compiled code cannot be kept, so that every run compiles anew (%s); set NUMBA_CACHE_DIR "
        "to a folder of yours",
        reason,
    )


def _digest(path: Path, content: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + content).digest()


def _write(path: Path, data: bytes) -> None:
    """Write a file as a whole, under a name that cannot be predicted until it is complete."""
    number, name = tempfile.mkstemp(prefix=".", suffix=".new", dir=path.parent)
    try:
        with open(number, "wb") as file:
            file.write(data)
            if _is_shared(path.parent):
                os.chmod(name, 0o644)
        os.replace(name, path)
    except OSError:
        with suppress(OSError):
            os.unlink(name)
        raise


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep other processes from compiling the same function at the same time, if the disk allows.

    Only on systems that have `fcntl`.
    """
    lock, number = path.with_suffix(".lock"), None
    with suppress(OSError, ImportError):
        import fcntl

        create_folder()
        number = os.open(lock, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o600)
        fcntl.flock(number, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if number is not None:
            with suppress(OSError):
                lock.unlink(missing_ok=True)
            os.close(number)


def create_folder() -> None:
    """Create the folder of the cache, for this user alone; root's is readable by all.

    Raises:
        OSError: it cannot be created.
    """
    path = folder()
    path.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        path.mkdir(mode=0o755 if _is_shared(path) else 0o700)


@lru_cache(maxsize=1)
def folder() -> Path:
    """The first that is ours: in NUMBA_CACHE_DIR, beside this module, in the user's cache folder.

    Then one for temporary files. If there is none, a path at which nothing can be saved.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        path = Path(given) / "vo"
        _close_to_others(path)
        reason = _refusal(path)
        if reason is None:
            return path
        _log.info("compiled code in NUMBA_CACHE_DIR is not used: %s %s", path, reason)
    with suppress(OSError):
        _beside().mkdir(exist_ok=True)
    if os.access(_beside(), os.W_OK) and _refusal(_beside()) is None:
        return _beside()
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    path = Path(cache) / "vo" / "compiled"
    if os.path.isabs(cache) and _refusal(path) is None and (path.exists() or _can_make(path)):
        return path
    return _temporary() or _NOWHERE


def _temporary() -> Path | None:
    """A user's own folder beside other temporary files; None if there can be none."""
    if not hasattr(os, "geteuid"):
        return None
    with suppress(OSError):
        path = Path(tempfile.gettempdir()) / f"vo-compiled-{os.geteuid()}"
        is_elsewhere = path.parent != Path.cwd()  # which Python takes where there is no other
        if is_elsewhere and _refusal(path) is None and (path.exists() or _can_make(path)):
            return path
    return None


def _can_make(path: Path) -> bool:
    """Whether a missing folder can be made."""
    existing = next(each for each in path.parents if each.exists())
    return existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)


def is_numba_cache_safe() -> bool:
    """Whether nobody else can write to numba's own cache, which consists of pickles."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    return not given or _refusal(Path(given)) is None


def _close_to_others(path: Path) -> None:
    """Forbid others to write to our own folder; files by others are refused in any case."""
    with suppress(OSError):
        info = path.lstat()
        if stat.S_ISDIR(info.st_mode) and info.st_mode & _WRITABLE_BY_OTHERS:
            path.chmod(stat.S_IMODE(info.st_mode) & ~_WRITABLE_BY_OTHERS)


def _refusal(path: Path) -> str | None:
    """Why a folder is not used; None if it is ours, or if it can be created."""
    try:
        info = path.lstat()
    except FileNotFoundError:
        return None
    except OSError as error:
        return f"cannot be opened ({error.strerror})"
    if not stat.S_ISDIR(info.st_mode):
        return "is not a folder"
    if not hasattr(os, "geteuid"):  # Windows keeps such folders private in other ways
        return None
    if path == _beside():
        package = path.parent.stat()
        is_as_safe = not info.st_mode & ~package.st_mode & _WRITABLE_BY_OTHERS
        return None if is_as_safe else "can be written to by more users than the package"
    if info.st_uid not in (os.geteuid(), 0):
        return "belongs to another user"
    return "can be written to by other users" if info.st_mode & _WRITABLE_BY_OTHERS else None


def _is_own_file(info: os.stat_result, path: Path) -> bool:
    """Whether nobody else can have written a file. Of several links, one may be elsewhere."""
    if not stat.S_ISREG(info.st_mode):
        return False
    if path.parent == _beside() or not hasattr(os, "geteuid"):
        return True
    is_ours = info.st_uid == 0 or (info.st_uid == os.geteuid() and info.st_nlink == 1)
    return is_ours and not info.st_mode & _WRITABLE_BY_OTHERS


def _is_shared(path: Path) -> bool:
    """Whether other users may read what is saved in a folder: root's, and the package's."""
    return path == _beside() or (hasattr(os, "geteuid") and os.geteuid() == 0)


def _beside() -> Path:
    return Path(__file__).parent / "__pycache__"
