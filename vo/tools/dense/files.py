"""Files of dense results, for other programs."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any
from uuid import UUID

import cv2
import numpy as np

from vo.base.errors import OutputError
from vo.base.extras import require
from vo.base.files.complete_file import complete_file, writing
from vo.base.types import Bytes, Floats
from vo.recordings.formats.mesh import Mesh
from vo.tools.dense.cloud import Cloud
from vo.tools.dense.ground import Grid
from vo.tools.drawing import write_picture

_POINT = np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])
_VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
_FACE = np.dtype([("n", "u1"), ("rows", "<i4", 3)])
_LAS_RGB_FORMAT, _LAS_VERSION = 2, "1.2"
CLOUD_SUFFIXES = (".las", ".laz", ".e57")
_PICTURE_PX, _MARGIN_PX = 900, 20
_PATH_BGR = 0, 94, 213


def write_cloud(path: Path, cloud: Cloud, comment: str) -> None:
    """Write points as LAS, LAZ or E57 by the suffix, else as PLY.

    Raises:
        OutputError: the file cannot be written.
        MissingExtraError: LAS needs the extra `las`, E57 the extra `e57`.
    """
    if path.suffix.lower() in CLOUD_SUFFIXES:
        write = _write_e57 if path.suffix.lower() == ".e57" else _write_las
        write(path, cloud, comment)
        return
    rows = np.zeros(len(cloud.xyz), _POINT)
    rows["xyz"], rows["normal"], rows["rgb"] = cloud.xyz, cloud.normal, cloud.rgb
    names = ("x", "y", "z", "nx", "ny", "nz")
    properties = [f"float {name}" for name in names] + _COLOURS
    _write_ply(path, comment, [("vertex", properties, rows)])


def write_mesh(path: Path, mesh: Mesh, comment: str) -> None:
    """Write triangles as PLY.

    Raises:
        OutputError: the file cannot be written.
    """
    vertices = np.zeros(len(mesh.vertices), _VERTEX)
    vertices["xyz"], vertices["rgb"] = mesh.vertices, mesh.rgb
    faces = np.zeros(len(mesh.triangles), _FACE)
    faces["n"], faces["rows"] = 3, mesh.triangles
    properties = [f"float {name}" for name in "xyz"] + _COLOURS
    parts = [("vertex", properties, vertices)]
    _write_ply(path, comment, [*parts, ("face", ["list uchar int vertex_indices"], faces)])


_COLOURS = [f"uchar {name}" for name in ("red", "green", "blue")]


def _write_ply(path: Path, comment: str, parts: list[tuple[str, list[str], Any]]) -> None:
    lines = ["ply", "format binary_little_endian 1.0", f"comment {' '.join(comment.split())}"]
    for element, properties, rows in parts:
        lines.append(f"element {element} {len(rows)}")
        lines += [f"property {each}" for each in properties]
    with writing(path), complete_file(path) as file:
        file.write("\n".join([*lines, "end_header", ""]).encode("ascii", "replace"))
        for _, _, rows in parts:
            file.write(rows.tobytes())


def _write_las(path: Path, cloud: Cloud, comment: str) -> None:
    laspy = require("laspy", "las", "LAS files")
    header = laspy.LasHeader(point_format=_LAS_RGB_FORMAT, version=_LAS_VERSION)
    header.offsets = np.floor(cloud.xyz.min(axis=0)) if len(cloud.xyz) else np.zeros(3)
    header.scales = np.full(3, 1e-3)
    header.system_identifier = comment[:32]
    header.generating_software = "vo"
    data = laspy.LasData(header)
    data.x, data.y, data.z = cloud.xyz.T
    data.red, data.green, data.blue = cloud.rgb.T.astype(np.uint16) * 257
    with writing(path), complete_file(path) as file:
        data.write(file, do_compress=path.suffix.lower() == ".laz")


def _write_e57(path: Path, cloud: Cloud, comment: str) -> None:
    """Single precision about an offset; identifiers are those of the contents."""
    from unittest.mock import patch

    pye57 = require("pye57", "e57", "E57 files")
    if not len(cloud.xyz):
        raise OutputError(f"{path} cannot be written: an E57 file needs points")
    offset = np.floor(cloud.xyz.min(axis=0))
    names = [*(f"cartesian{axis}" for axis in "XYZ"), *(f"color{c}" for c in _CHANNELS)]
    columns = [*(cloud.xyz - offset).T, *cloud.rgb.T]
    points = {name: np.ascontiguousarray(each) for name, each in zip(names, columns, strict=True)}
    digest = sha256(b"".join(each.tobytes() for each in (*columns, offset)) + comment.encode())
    identifiers = (UUID(bytes=digest.digest()[k : k + 16], version=4) for k in (0, 16))
    # It names random identifiers, and the folder where it is installed as its version.
    source_of_names = SimpleNamespace(uuid4=identifiers.__next__)
    with (
        writing(path),
        complete_file(path) as file,
        TemporaryDirectory() as folder,
        patch.multiple(pye57.e57, uuid=source_of_names, __version__="pye57"),
    ):
        made = Path(folder) / "cloud.e57"
        scan = pye57.E57(str(made), mode="w")
        scan.write_scan_raw(points, name=comment, translation=offset)
        scan.close()
        file.write(made.read_bytes())


_CHANNELS = ("Red", "Green", "Blue")


def write_grid(folder: Path, grid: Grid, comment: str) -> list[Path]:
    """Write `map.pgm` and `map.yaml`, as ROS' map server reads them.

    Raises:
        OutputError: a file cannot be written.
    """
    picture, description = folder / "map.pgm", folder / "map.yaml"
    rows, columns = grid.cells.shape
    x, y = grid.origin
    text = (
        f"# {' '.join(comment.split())}\nimage: {picture.name}\nmode: trinary\n"
        f"resolution: {grid.edge:g}\norigin: [{x:.6g}, {y:.6g}, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    with writing(picture), complete_file(picture) as file:
        file.write(f"P5\n{columns} {rows}\n255\n".encode() + grid.cells.tobytes())
    with writing(description), complete_file(description) as file:
        file.write(text.encode())
    return [picture, description]


def write_voxels(path: Path, points: Floats, edge: float, ground_from_world: Floats) -> None:
    """Write the occupied voxels of points (N, 3) over the ground as `.npz`.

    `occupied` (V, 3) int32 counts edges from the origin of the ground along x, y and z.

    Raises:
        OutputError: the file cannot be written.
    """
    occupied = np.unique(np.floor(points / edge).astype(np.int32), axis=0)
    with writing(path), complete_file(path) as file:
        np.savez_compressed(file, occupied=occupied, edge=edge, ground_from_world=ground_from_world)


def write_views(folder: Path, points: Floats, rgb: Bytes, path: Floats) -> list[Path]:
    """Pictures of points (N, 3), z up, and a path (K, 3): from above, and from four sides.

    Raises:
        OutputError: a file cannot be written.
    """
    above, around = folder / "above.png", folder / "turntable.png"
    write_picture(above, _view(points, rgb, path, 0.0, 90.0, _PICTURE_PX))
    views = [_view(points, rgb, path, 90.0 * k, 35.0, _PICTURE_PX // 2) for k in range(4)]
    write_picture(around, np.vstack([np.hstack(views[:2]), np.hstack(views[2:])]))
    return [above, around]


def _view(
    points: Floats, rgb: Bytes, path: Floats, turn_deg: float, raise_deg: float, size: int
) -> Bytes:
    """A parallel projection (size, size, 3) BGR, turned about z, from so far above the horizon."""
    (c, s), (up, down) = (
        (np.cos(angle), np.sin(angle)) for angle in np.deg2rad((turn_deg, 90.0 - raise_deg))
    )
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, up, down], [0.0, -down, up]]) @ turned
    seen, line = points @ rotation.T, path @ rotation.T
    low, high = (np.percentile(seen[:, :2], share, axis=0) for share in (0.5, 99.5))
    low, high = np.minimum(low, line[:, :2].min(axis=0)), np.maximum(high, line[:, :2].max(axis=0))
    scale = (size - 2 * _MARGIN_PX) / max(float((high - low).max()), 1e-9)
    offset = 0.5 * (size - scale * (low + high))
    picture = np.full((size, size, 3), 255, np.uint8)
    height = seen[:, 2] - seen[:, 2].min(initial=0.0)
    steps = (height * (65535 / max(float(height.max(initial=0.0)), 1e-9))).astype(np.uint16)
    order = np.argsort(steps, kind="stable")  # the nearest last
    at = np.floor(seen[order, :2] * scale + offset).astype(np.int64)
    inside = ((at >= 0) & (at < size)).all(axis=1)
    picture[at[inside, 1], at[inside, 0]] = rgb[order][inside][:, ::-1]
    drawn = np.round(line[:, :2] * scale + offset).astype(np.int32)
    cv2.polylines(picture, [drawn], False, _PATH_BGR, 2, cv2.LINE_AA)
    return np.ascontiguousarray(picture[::-1])
