"""Files as torch saves them, written without torch."""

from __future__ import annotations

import io
import pickle
import sys
import types
import zipfile
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from numpy.typing import NDArray


class _Storage:
    def __init__(self, key: str, numbers: NDArray[Any]) -> None:
        self.key, self.numbers = key, numbers


class _Tensor:
    """A tensor as a part of a storage, to be pickled as torch does it."""

    def __init__(
        self, storage: _Storage, offset: int, size: tuple[int, ...], stride: tuple[int, ...]
    ) -> None:
        self.parts = (storage, offset, size, stride, False, OrderedDict())

    def __reduce__(self) -> Any:
        return sys.modules["torch._utils"]._rebuild_tensor_v2, self.parts


@contextmanager
def _torch_names() -> Iterator[types.ModuleType]:
    """Modules with the few names that a pickle refers to."""
    torch, inner = types.ModuleType("torch"), types.ModuleType("torch._utils")

    def _rebuild_tensor_v2(*_: Any) -> None: ...

    _rebuild_tensor_v2.__module__ = "torch._utils"
    _rebuild_tensor_v2.__qualname__ = "_rebuild_tensor_v2"
    inner._rebuild_tensor_v2 = _rebuild_tensor_v2  # type: ignore[attr-defined]
    for name in ("FloatStorage", "LongStorage", "HalfStorage"):
        setattr(torch, name, type(name, (), {"__module__": "torch"}))
    before = {n: sys.modules.get(n) for n in ("torch", "torch._utils")}
    sys.modules.update({"torch": torch, "torch._utils": inner})
    try:
        yield torch
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


_KINDS = {"f4": "FloatStorage", "i8": "LongStorage", "f2": "HalfStorage"}


def _content(
    tensors: Mapping[str, NDArray[Any]], extra: Any
) -> tuple[dict[str, Any], list[_Storage]]:
    """What is pickled, and the storages of its tensors."""
    storages = {n: _Storage(str(i), t) for i, (n, t) in enumerate(tensors.items())}
    content: dict[str, Any] = OrderedDict(
        (n, _Tensor(storages[n], 0, t.shape, tuple(s // t.itemsize for s in t.strides)))
        for n, t in tensors.items()
    )
    if extra is not None:
        content["extra"] = extra
    return content, list(storages.values())


def _pickled(torch: types.ModuleType, content: Any, *view: None) -> bytes:
    """A pickle that names storages; files of before torch 1.6 add a view to each."""

    class Pickler(pickle.Pickler):
        def persistent_id(self, value: Any) -> Any:
            if not isinstance(value, _Storage):
                return None
            kind = getattr(torch, _KINDS[value.numbers.dtype.str[1:]])
            return ("storage", kind, value.key, "cpu", value.numbers.size, *view)

    data = io.BytesIO()
    Pickler(data, protocol=2).dump(content)
    return data.getvalue()


def torch_file(
    tensors: Mapping[str, NDArray[Any]], extra: Any = None, group: str | None = None
) -> bytes:
    """A file with named tensors, perhaps in a group, and with something else to be pickled."""
    content, storages = _content(tensors, extra)
    content = content if group is None else {group: content}
    return torch_archive(content, storages)


def old_torch_file(tensors: Mapping[str, NDArray[Any]], extra: Any = None) -> bytes:
    """The same in the format of before torch 1.6: pickles, and the numbers one after the other."""
    content, storages = _content(tensors, extra)
    data = io.BytesIO()
    system = {"protocol_version": 1001, "little_endian": True, "type_sizes": {"int": 4}}
    with _torch_names() as torch:
        keys = [storage.key for storage in storages]
        for part in (0x1950A86A20F9469CFC6C, 1001, system, content, keys):
            data.write(_pickled(torch, part, None))
    for storage in storages:
        data.write(storage.numbers.size.to_bytes(8, "little"))
        data.write(storage.numbers.tobytes(order="A"))
    return data.getvalue()


def torch_archive(content: Any, storages: Iterable[_Storage]) -> bytes:
    """A file with any content, and its storages."""
    with _torch_names() as torch:
        pickled = _pickled(torch, content)
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        archive.writestr("model/data.pkl", pickled)
        for storage in storages:
            numbers = storage.numbers
            archive.writestr(f"model/data/{storage.key}", numbers.tobytes(order="A"))
        archive.writestr("model/version", "3\n")
    return data.getvalue()
