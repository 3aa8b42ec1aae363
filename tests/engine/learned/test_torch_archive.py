"""Reading of torch's files without torch, and without running anything in them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from torch_files import _Storage, _Tensor, old_torch_file, torch_archive, torch_file

from vo.base.errors import ModelError
from vo.tools.models.torch_archive import read_tensors


def test_tensors_are_read_as_they_were_saved() -> None:
    noise = np.random.default_rng(0)
    tensors = {
        "a.weight": noise.random((4, 3, 3, 3), dtype=np.float32),
        "count": np.array([7], np.int64),
        "half": noise.random((5, 2)).astype(np.float16),
        "turned": noise.random((3, 5), dtype=np.float32).T,
        "empty": np.empty((0, 3), np.float32),
    }
    found = read_tensors(torch_file(tensors), "weights.pt")
    assert list(found) == list(tensors)
    for name, tensor in tensors.items():
        np.testing.assert_array_equal(found[name], tensor)
        assert found[name].dtype == tensor.dtype


def test_files_of_older_versions_are_read_as_well() -> None:
    noise = np.random.default_rng(2)
    tensors = {
        "a.weight": noise.random((4, 3, 1), dtype=np.float32),
        "count": np.array([7], np.int64),
        "scalar": np.array(0.5, np.float32),
        "turned": noise.random((3, 5), dtype=np.float32).T,
    }
    data = old_torch_file(tensors)
    found = read_tensors(data, "weights.pth")
    assert list(found) == list(tensors)
    for name, tensor in tensors.items():
        np.testing.assert_array_equal(found[name], tensor)
        assert found[name].dtype == tensor.dtype
    for cut in (20, len(data) // 2, len(data) - 3):
        with pytest.raises(ModelError, match="weights"):
            read_tensors(data[:cut], "weights.pth")
    hostile = old_torch_file(tensors, Hostile())
    with pytest.raises(ModelError, match=r"holds posix\.system, not only tensors"):
        read_tensors(hostile, "weights.pth")
    assert not Path("/tmp/vo-was-hacked").exists()
    for place in noise.integers(0, len(data), 300):
        changed = bytearray(data)
        changed[place] = noise.integers(0, 256)
        try:
            read_tensors(bytes(changed), "weights.pth")
        except ModelError as error:
            assert "\n" not in str(error)[:200]


class Hostile:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("touch /tmp/vo-was-hacked",)


def test_a_file_with_code_in_it_runs_nothing() -> None:
    data = torch_file({"a": np.zeros(3, np.float32)}, Hostile())
    with pytest.raises(ModelError, match=r"holds posix\.system, not only tensors"):
        read_tensors(data, "weights.pt")
    assert not Path("/tmp/vo-was-hacked").exists()


@pytest.mark.parametrize(
    ("offset", "size", "stride"),
    [
        (0, (100,), (1,)),
        (5, (3, 3), (3, 1)),
        (0, (4,), (10**9,)),
        (-3, (4,), (1,)),
        (0, (4,), (-1,)),
    ],
)
def test_a_tensor_outside_of_its_storage_is_refused(
    offset: int, size: tuple[int, ...], stride: tuple[int, ...]
) -> None:
    storage = _Storage("0", np.zeros(10, np.float32))
    data = torch_archive({"a": _Tensor(storage, offset, size, stride)}, [storage])
    with pytest.raises(ModelError, match="outside of its storage"):
        read_tensors(data, "weights.pt")


def test_what_is_no_such_file_is_refused() -> None:
    whole = torch_file({"a": np.arange(1000, dtype=np.float32)})
    for data in (b"", b"PK", b"nothing", whole[: len(whole) // 2], whole[:-30]):
        with pytest.raises(ModelError, match="weights"):
            read_tensors(data, "weights.pt")


def test_any_changed_byte_gives_tensors_or_an_error() -> None:
    whole = torch_file({"a": np.arange(20, dtype=np.float32), "b": np.ones((2, 3), np.float32)})
    noise = np.random.default_rng(1)
    for _ in range(400):
        changed = bytearray(whole)
        for place in noise.integers(0, len(whole), int(noise.integers(1, 4))):
            changed[place] = noise.integers(0, 256)
        try:
            read_tensors(bytes(changed), "weights.pt")
        except ModelError as error:
            assert "\n" not in str(error)[:200]


def test_tensors_in_a_group_have_its_name_before_theirs() -> None:
    data = torch_file({"a.weight": np.arange(3, dtype=np.float32)}, group="extractor")
    found = read_tensors(data, "grouped.pth")
    assert list(found) == ["extractor.a.weight"]
    np.testing.assert_array_equal(found["extractor.a.weight"], [0, 1, 2])
