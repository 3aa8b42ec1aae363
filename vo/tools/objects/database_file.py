r"""Files of object databases.

Layout, little-endian: `vo-objs\n`; uint32 version; uint32 length of the index; the index in JSON;
the arrays, each at a multiple of 8 bytes; SHA-256 of all before. docs/objects.md has the index.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.errors import OutputError, SourceError
from vo.base.files.bounded_files import read_bytes
from vo.base.files.bounded_json import load_json
from vo.base.files.complete_file import complete_file
from vo.base.types import Floats32
from vo.tools.objects.stored_objects import Part, Solid, StoredObject

_MAGIC = b"vo-objs\n"
_VERSION, _WITHOUT_SOLIDS = 2, 1  # databases without solids are of the older one
_HEAD = struct.Struct("<8sII")
_DIGEST_BYTES = 32
_ALIGNMENT = 8
_MAX_BYTES = 4 * 2**30
_ARRAYS = {  # name: types, shape with None for any length
    "xy": (("<f4",), (None, 2)),
    "descriptor": (("|u1", "|i1"), (None, None)),
    "code": (("<u8",), (None, 4)),
    "angle": (("<f4",), (None,)),
    "size": (("<f4",), (None,)),
    "outline": (("<f4",), (4, 2)),
    "thumbnail": (("|u1",), (None, None)),
}
_SOLID_ARRAYS = {
    "xyz": (("<f4",), (None, 3)),
    "ray": (("<f4",), (None, 3)),
    "sigma": (("<f4",), (None,)),
    "descriptor": _ARRAYS["descriptor"],
    "box": (("<f4",), (2, 3)),
}
_ROWS = ("xy", "descriptor", "code", "angle", "size")  # of equal length


class FileContents(NamedTuple):
    """What is in a file."""

    detector: str  # value of `features.detector`
    descriptor: str  # value of `features.descriptor`
    # (width,) of the descriptors' unit vectors; None without objects so far
    centre: Floats32 | None
    objects: tuple[StoredObject, ...]  # in the order in which they were added


def write_objects(path: Path, contents: FileContents) -> None:
    """Write a database; an existing file is replaced when the new one is complete and on disk.

    Raises:
        OutputError: the file cannot be written; one that was there is as before.
    """
    data: list[bytes] = []
    length = 0

    def add(array: NDArray[Any]) -> list[Any]:
        nonlocal length
        kind = array.dtype.newbyteorder("<").str
        content = np.ascontiguousarray(array, kind).tobytes()
        begin = length
        padded = content + bytes(-len(content) % _ALIGNMENT)
        data.append(padded)
        length += len(padded)
        return [kind, list(array.shape), begin]

    index = {
        "detector": contents.detector,
        "descriptor": contents.descriptor,
        "centre": None if contents.centre is None else add(contents.centre),
        "objects": [
            {
                "name": each.name,
                "images": each.images,
                "parts": [
                    {
                        "unit_m": float(part.unit_m) if np.isfinite(part.unit_m) else None,
                        "image_size": list(part.image_size),
                        **{name: add(getattr(part, name)) for name in _ARRAYS},
                    }
                    for part in each.parts
                ],
                **({} if each.solid is None else {"solid": _solid_record(each.solid, add)}),
            }
            for each in contents.objects
        ],
    }
    text = json.dumps(index, separators=(",", ":")).encode()
    text += b" " * (-len(text) % _ALIGNMENT)
    digest = hashlib.sha256()
    version = _VERSION if any(each.solid for each in contents.objects) else _WITHOUT_SOLIDS
    try:
        with complete_file(path) as file:
            for piece in (_HEAD.pack(_MAGIC, version, len(text)), text, *data):
                digest.update(piece)
                file.write(piece)
            file.write(digest.digest())
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error


def read_objects(path: Path) -> FileContents:
    """Read a database.

    Raises:
        SourceError: the file is missing, something else, damaged, or of a newer version.
    """
    try:
        data = read_bytes(path, _MAX_BYTES)
    except OSError as error:
        raise SourceError(f"cannot read the database {path}: {error.strerror}") from error
    if not data.startswith(_MAGIC):
        raise SourceError(
            f"{path} is no database of objects; make one with `vo recognize add NAME IMAGE`"
        )
    if len(data) < _HEAD.size + _DIGEST_BYTES:
        raise _damaged(path)
    _, version, length = _HEAD.unpack_from(data)
    if version > _VERSION:
        raise SourceError(
            f"{path} is a database of version {version}, this vo reads {_VERSION}; update vo"
        )
    content = memoryview(data)[:-_DIGEST_BYTES]
    begin = _HEAD.size + length
    if hashlib.sha256(content).digest() != data[-_DIGEST_BYTES:] or begin > len(content):
        raise _damaged(path)
    try:
        return _contents(load_json(bytes(content[_HEAD.size : begin])), content[begin:])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _damaged(path) from error


def _contents(index: dict[str, Any], arrays: memoryview) -> FileContents:
    centre = index["centre"]
    objects = tuple(_object(each, arrays) for each in index["objects"])
    if len({each.name for each in objects}) != len(objects):
        raise ValueError("two objects of one name")
    middle = None if centre is None else _array(centre, arrays, ("<f4",), (None,))
    stored = [part.descriptor for each in objects for part in each.parts]
    stored += [each.solid.descriptor for each in objects if each.solid is not None]
    widths = {(descriptor.shape[1], descriptor.dtype.kind) for descriptor in stored}
    if len(widths) > 1 or (objects and middle is None):
        raise ValueError("descriptors of several kinds")
    return FileContents(str(index["detector"]), str(index["descriptor"]), middle, objects)


def _object(record: dict[str, Any], arrays: memoryview) -> StoredObject:
    parts = tuple(_part(each, arrays) for each in record["parts"])
    solid = None if "solid" not in record else _solid(record["solid"], arrays)
    if bool(parts) is bool(solid):
        raise ValueError("an object without parts, or with both kinds")
    return StoredObject(str(record["name"]), parts, int(record["images"]), solid)


def _solid_record(solid: Solid, add: Callable[[NDArray[Any]], list[Any]]) -> dict[str, Any]:
    arrays = {name: add(getattr(solid, name)) for name in _SOLID_ARRAYS}
    return {"is_metric": solid.is_metric, **arrays}


def _solid(record: dict[str, Any], arrays: memoryview) -> Solid:
    read = {name: _array(record[name], arrays, *form) for name, form in _SOLID_ARRAYS.items()}
    if len({len(read[name]) for name in ("xyz", "ray", "sigma", "descriptor")}) != 1:
        raise ValueError("arrays of different lengths")
    if not all(np.isfinite(read[name]).all() for name in ("xyz", "ray", "sigma", "box")):
        raise ValueError("values out of range")
    if not (read["box"][0] < read["box"][1]).all() or not (read["sigma"] > 0).all():
        raise ValueError("values out of range")
    return Solid(is_metric=record["is_metric"] is True, **read)


def _part(record: dict[str, Any], arrays: memoryview) -> Part:
    read = {name: _array(record[name], arrays, *form) for name, form in _ARRAYS.items()}
    if len({len(read[name]) for name in _ROWS}) != 1:
        raise ValueError("arrays of different lengths")
    is_finite = all(np.isfinite(read[name]).all() for name in ("xy", "size", "outline"))
    if not is_finite or not (read["size"] > 0).all() or 0 in read["thumbnail"].shape:
        raise ValueError("values out of range")
    unit_m = record["unit_m"]
    width, height = record["image_size"]
    return Part(
        unit_m=float("nan") if unit_m is None else float(unit_m),
        image_size=(int(width), int(height)),
        **read,
    )


def _array(
    place: Any, arrays: memoryview, kinds: tuple[str, ...], shape: tuple[int | None, ...]
) -> NDArray[Any]:
    kind, size, begin = place
    fits = len(size) == len(shape) and all(
        type(n) is int and 0 <= n < 2**31 and wanted in (None, n)
        for n, wanted in zip(size, shape, strict=True)
    )
    if kind not in kinds or not fits or type(begin) is not int or begin < 0:
        raise ValueError("an array of another kind")
    count = int(np.prod([int(n) for n in size], dtype=object))
    return np.frombuffer(arrays, kind, count, begin).reshape(size)


def _damaged(path: Path) -> SourceError:
    return SourceError(f"the database {path} is damaged or cut off; use a copy, or make it anew")
