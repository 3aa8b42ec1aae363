"""Triangle meshes: Wavefront OBJ, and PLY as text or binary."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.base.files.bounded_files import read_bytes
from vo.base.types import Bytes, Floats, Ints

MAX_BYTES = 512 * 2**20
_GREY = (190, 190, 190)
_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles.

    Attributes:
        vertices: (V, 3).
        triangles: (T, 3) rows of vertices.
        rgb: (V, 3) uint8 colours.
    """

    vertices: Floats
    triangles: Ints
    rgb: Bytes


def read_mesh(path: Path) -> Mesh:
    """Read a mesh by the suffix of its file; polygons become fans of triangles."""
    try:
        data = read_bytes(path, MAX_BYTES)
    except FileNotFoundError as error:
        raise SourceError(f"{path} does not exist; give a model as .ply or .obj") from error
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror or error}") from error
    kind = path.suffix.lower()
    try:
        if kind == ".ply":
            mesh = _ply(data)
        elif kind == ".obj":
            mesh = _obj(data.decode("utf-8", "replace"))
        else:
            raise SourceError(f"{path} is no model: give a .ply or .obj file")
    except (ValueError, IndexError, KeyError) as error:
        raise SourceError(f"{path} is damaged: {error}") from error
    if not len(mesh.triangles):
        raise SourceError(f"{path} has no triangles, only points; give a mesh")
    in_range = (mesh.triangles >= 0) & (mesh.triangles < len(mesh.vertices))
    if not in_range.all() or not np.isfinite(mesh.vertices).all():
        raise SourceError(f"{path} is damaged: a face has a vertex that does not exist")
    return mesh


def _obj(text: str) -> Mesh:
    vertices: list[list[float]] = []
    colours: list[list[float]] = []
    triangles: list[list[int]] = []
    for line in text.splitlines():
        kind, *fields = line.split() or [""]
        if kind == "v":
            numbers = [float(field) for field in fields]
            vertices.append(numbers[:3])
            colours.append([255.0 * v for v in numbers[3:6]] if len(numbers) >= 6 else list(_GREY))
        elif kind == "f":
            rows = [int(field.split("/")[0]) for field in fields]
            corners = [row - 1 if row > 0 else len(vertices) + row for row in rows]
            triangles += _fan(corners)
    return _mesh(vertices, triangles, colours)


def _fan(corners: list[int]) -> list[list[int]]:
    return [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]


def _mesh(
    vertices: list[list[float]], triangles: list[list[int]], colours: list[list[float]]
) -> Mesh:
    return Mesh(
        np.array(vertices, np.float64).reshape(-1, 3),
        np.array(triangles, np.int64).reshape(-1, 3),
        np.clip(np.array(colours).reshape(-1, 3), 0, 255).astype(np.uint8),
    )


def _ply(data: bytes) -> Mesh:
    header, end, body = data.partition(b"end_header")
    if not data.startswith(b"ply") or not end:
        raise ValueError("it has no header of PLY")
    body = body[body.index(b"\n") + 1 :]
    encoding, elements = _ply_header(header.decode("ascii", "replace"))
    order = "<" if "little" in encoding else ">"
    values = _AsciiValues(body) if encoding == "ascii" else _BinaryValues(body, order)
    vertices: list[list[float]] = []
    colours: list[list[float]] = []
    triangles: list[list[int]] = []
    for name, count, properties in elements:
        if count > len(body):
            raise ValueError(f"it is cut off in its {name}s")
        for _ in range(count):
            row = {key: values.take(types) for key, types in properties}
            if name == "vertex":
                vertices.append([row[axis][0] for axis in "xyz"])
                has_colour = "red" in row
                colours.append(
                    [row[c][0] for c in ("red", "green", "blue")] if has_colour else list(_GREY)
                )
            elif name == "face":
                corners = row.get("vertex_indices") or row.get("vertex_index") or []
                triangles += _fan([int(corner) for corner in corners])
    return _mesh(vertices, triangles, colours)


def _ply_header(text: str) -> tuple[str, list[tuple[str, int, list[tuple[str, tuple[str, ...]]]]]]:
    """The encoding, and name, count and properties of each element."""
    encoding = ""
    elements: list[tuple[str, int, list[tuple[str, tuple[str, ...]]]]] = []
    for line in text.splitlines():
        fields = line.split()
        if fields[:1] == ["format"]:
            encoding = fields[1]
        elif fields[:1] == ["element"]:
            elements.append((fields[1], int(fields[2]), []))
        elif fields[:1] == ["property"]:
            types = fields[2:4] if fields[1] == "list" else fields[1:2]
            elements[-1][2].append((fields[-1], tuple(_PLY_TYPES[each] for each in types)))
    if not encoding:
        raise ValueError("it names no format")
    return encoding, elements


class _AsciiValues:
    def __init__(self, body: bytes) -> None:
        self._fields = iter(body.split())

    def take(self, types: tuple[str, ...]) -> list[float]:
        try:
            count = int(next(self._fields)) if len(types) == 2 else 1
            return [float(next(self._fields)) for _ in range(count)]
        except StopIteration:
            raise ValueError("it is cut off") from None


class _BinaryValues:
    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._place, self._order = body, 0, order

    def take(self, types: tuple[str, ...]) -> list[float]:
        count = int(self._read(types[0], 1)[0]) if len(types) == 2 else 1
        return self._read(types[-1], count)

    def _read(self, kind: str, count: int) -> list[float]:
        dtype = np.dtype(self._order + kind)
        if count < 0 or self._place + count * dtype.itemsize > len(self._body):
            raise ValueError("it is cut off")
        values = np.frombuffer(self._body, dtype, count, self._place)
        self._place += count * dtype.itemsize
        return [float(value) for value in values]
