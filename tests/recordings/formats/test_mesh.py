"""Meshes as other programs write them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.recordings.formats.mesh import read_mesh

HEADER = """ply
format {} 1.0
comment made by hand
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 1
property list uchar int vertex_indices
end_header
"""
VERTICES = [(0, 0, 0, 255, 0, 0), (1, 0, 0, 0, 255, 0), (1, 1, 0, 0, 0, 255), (0, 1, 0, 9, 9, 9)]


def ply(order: str) -> bytes:
    if order == "ascii":
        rows = [" ".join(map(str, row)) for row in VERTICES]
        return (HEADER.format("ascii") + "\n".join(rows) + "\n4 0 1 2 3\n").encode()
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    body = b"".join(struct.pack(f"{order}3f3B", *row) for row in VERTICES)
    return HEADER.format(name).encode() + body + struct.pack(f"{order}B4i", 4, 0, 1, 2, 3)


@pytest.mark.parametrize("order", ["ascii", "<", ">"])
def test_ply(tmp_path: Path, order: str) -> None:
    (tmp_path / "a.ply").write_bytes(ply(order))
    mesh = read_mesh(tmp_path / "a.ply")
    assert mesh.vertices.tolist() == [list(row[:3]) for row in VERTICES]
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.rgb.tolist() == [list(row[3:]) for row in VERTICES]


def test_obj(tmp_path: Path) -> None:
    text = (
        "# a\nv 0 0 0\nv 1 0 0 1 0.5 0\nv 1 1 0\nvn 0 0 1\nf 1//1 2//1 -1//1\nv 0 1 0\nf 1/2 3 4\n"
    )
    (tmp_path / "a.obj").write_text(text)
    mesh = read_mesh(tmp_path / "a.obj")
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.rgb[1].tolist() == [255, 127, 0] and np.ptp(mesh.rgb[0]) == 0


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.ply", b"solid", "no header"),
        ("a.ply", ply("<")[:-5], "cut off"),
        ("a.ply", ply("ascii")[:-12], "cut off"),
        ("a.ply", ply("ascii").replace(b"4 0 1 2 3", b"4 0 1 2 9"), "does not exist"),
        (
            "a.ply",
            ply("ascii").replace(b"element vertex 4", b"element vertex 999999999"),
            "cut off",
        ),
        ("a.ply", ply("ascii").replace(b"float x", b"quad x"), "damaged"),
        ("a.obj", b"v 0 0 0\nv 1 1 1\n", "no triangles"),
        ("a.obj", b"v 0 0 x\n", "damaged"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", "does not exist"),
        ("a.stl", b"", "give a .ply or .obj"),
    ],
)
def test_damaged_meshes(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(SourceError, match=message):
        read_mesh(tmp_path / name)
    with pytest.raises(SourceError, match="does not exist"):
        read_mesh(tmp_path / "none.obj")
