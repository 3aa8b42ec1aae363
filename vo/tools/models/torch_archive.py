"""Tensors of a file that torch has saved, read without torch and without running code of it.

Such a file is a zip archive with a pickle, which describes the tensors, and their raw numbers; or,
before torch 1.6, several pickles and the numbers one after the other.
Unpickling can run any code: here only the few names that describe a tensor are allowed.
"""

from __future__ import annotations

import io
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np

from vo.base.errors import ModelError
from vo.engine.learned.graph import Tensor

_TYPES = {
    "FloatStorage": "<f4",
    "DoubleStorage": "<f8",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ByteStorage": "|u1",
    "BoolStorage": "|b1",
}
# The first pickle of a file of before torch 1.6: a number that marks the format.
OLD_FORMAT = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19."
_MAX_BYTES = 2**30
_MAX_PICKLE_BYTES = 2**24


def read_tensors(data: bytes, name: str) -> dict[str, Tensor]:
    """All named tensors of a file; those in a group are named `GROUP.NAME`.

    Raises:
        ModelError: it is not such a file, damaged, or holds something else than tensors.
    """
    try:
        if data.startswith(OLD_FORMAT):
            return _OldFile(data, name).tensors()
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _Archive(archive, name).tensors()
    except ModelError:
        raise
    except Exception as error:  # whatever damaged bytes make the two formats raise
        raise ModelError(f"{name} is no file of tensors, or damaged: {error}") from error


class _Storage:
    """Numbers of one or several tensors."""

    def __init__(self, numbers: Tensor) -> None:
        self.numbers = numbers


class _File:
    """What the unpickler asks for; `rebuild` makes a tensor."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.rebuild: Callable[..., Tensor | None] = _tensor

    def storage(self, kind: str, key: str) -> _Storage:
        """The numbers of this key."""
        raise NotImplementedError

    def refuse(self, what: str) -> ModelError:
        return ModelError(f"{self._name} holds {what}, not only tensors; it was not read further")

    def named(self, content: Any) -> dict[str, Tensor]:
        if not isinstance(content, dict):
            raise ModelError(f"{self._name} holds no named tensors")
        tensors = {str(k): v for k, v in content.items() if isinstance(v, np.ndarray)}
        for group, inner in content.items():
            if isinstance(inner, dict):
                each = {f"{group}.{k}": v for k, v in inner.items() if isinstance(v, np.ndarray)}
                tensors |= each
        return tensors


class _OldFile(_File):
    """Pickles of a mark, a version, the system and the tensors; keys; the numbers of each key."""

    def __init__(self, data: bytes, name: str) -> None:
        super().__init__(name)
        self._data = data
        self._kinds: dict[str, str] = {}
        self._numbers: dict[str, Tensor] = {}

    def tensors(self) -> dict[str, Tensor]:
        file = io.BytesIO(self._data)
        for _ in range(2):
            self._load(file)
        if not self._load(file).get("little_endian", True):
            raise ModelError(f"{self._name} has numbers in big-endian order")
        begin = file.tell()
        self.rebuild = lambda *_: None  # the numbers come later: only their types are read
        self._load(file)
        for key in self._load(file):
            dtype = np.dtype(_TYPES[self._kinds[key]])
            count = int.from_bytes(file.read(8), "little")
            if count * dtype.itemsize > len(self._data) - file.tell():
                raise ModelError(f"{self._name} is cut off")
            self._numbers[key] = np.frombuffer(file.read(count * dtype.itemsize), dtype)
        self.rebuild = _tensor
        file.seek(begin)
        return self.named(self._load(file))

    def storage(self, kind: str, key: str) -> _Storage:
        self._kinds[key] = kind
        return _Storage(self._numbers.get(key, np.empty(0, _TYPES[kind])))

    def _load(self, file: io.BytesIO) -> Any:
        return _Unpickler(file, self).load()


class _Archive(_File):
    def __init__(self, archive: zipfile.ZipFile, name: str) -> None:
        super().__init__(name)
        self._archive = archive
        found = [n for n in archive.namelist() if n.endswith("/data.pkl")]
        if len(found) != 1:
            raise ModelError(f"{name} is no file that torch has saved: it has no data.pkl")
        self._root = found[0].removesuffix("data.pkl")
        order = f"{self._root}byteorder"
        if order in archive.namelist() and self._read(order, 16).strip() != b"little":
            raise ModelError(f"{name} has numbers in big-endian order, which are not supported")

    def tensors(self) -> dict[str, Tensor]:
        pickled = io.BytesIO(self._read(f"{self._root}data.pkl", _MAX_PICKLE_BYTES))
        return self.named(_Unpickler(pickled, self).load())

    def storage(self, kind: str, key: str) -> _Storage:
        data = self._read(f"{self._root}data/{key}", _MAX_BYTES)
        return _Storage(np.frombuffer(data, dtype=np.dtype(_TYPES[kind])))

    def _read(self, member: str, max_bytes: int) -> bytes:
        if self._archive.getinfo(member).file_size > max_bytes:
            raise ModelError(f"{self._name}: {member} has more than {max_bytes} bytes")
        return self._archive.read(member)


class _StorageType:
    """Stands for one of torch's storage classes."""

    def __init__(self, name: str) -> None:
        self.name = name


class _Unpickler(pickle.Unpickler):
    """Knows the names that describe tensors, and refuses all others."""

    def __init__(self, file: io.BytesIO, archive: _File) -> None:
        super().__init__(file)
        self._archive = archive

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return self._archive.rebuild
        if module == "torch" and name in _TYPES:
            return _StorageType(name)
        raise self._archive.refuse(f"{module}.{name}")

    def persistent_load(self, reference: Any) -> Any:
        kind, storage_type, key, *_ = reference
        if kind != "storage" or not isinstance(storage_type, _StorageType):
            raise self._archive.refuse(f"a reference to {str(kind)[:40]}")
        return self._archive.storage(storage_type.name, str(key))


def _tensor(
    storage: _Storage, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any
) -> Tensor:
    """A tensor of a storage; sizes and strides in elements."""
    numbers = storage.numbers
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    if min((offset, *size, *stride), default=0) < 0 or (0 not in size and last >= len(numbers)):
        raise ModelError("a tensor lies outside of its storage")
    steps = [step * numbers.itemsize for step in stride]
    view = np.lib.stride_tricks.as_strided(numbers[offset:], size, steps, writeable=False)
    return np.array(view)
