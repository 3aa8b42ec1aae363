"""Writer of COLMAP models: posed images and points as text.

In COLMAP the corner of the top-left pixel is at (0, 0), so half a pixel is added here; poses are
cam_from_world with quaternions in the order w x y z; ids begin at 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.geometry.transforms import inverse, quat_xyzw_from_rotation
from vo.types import Bytes, Camera, Floats, Ints

MODEL_FILES = ("cameras.txt", "images.txt", "points3D.txt")
_CENTRE_TO_CORNER_PX = 0.5
_WITHOUT_K3, _WITH_K3 = 4, 5  # numbers of radtan coefficients


class ModelPoints(NamedTuple):
    """Points of a model; row i of each array belongs to the same point.

    Attributes:
        xyz: (M, 3) in the world.
        grey: (M,) grey levels.
        error_px: (M,) mean reprojection errors.
    """

    xyz: Floats
    grey: Bytes
    error_px: Floats


class ModelObservations(NamedTuple):
    """Observations of a model; row i of each array belongs to the same observation.

    Attributes:
        image: (N,) indices of the images, increasing.
        point: (N,) indices of the points.
        xy: (N, 2) pixels, the centre of the top-left pixel at (0, 0).
    """

    image: Ints
    point: Ints
    xy: Floats


def has_colmap_model(camera: Camera) -> bool:
    """Whether COLMAP has a camera model with this distortion."""
    return camera.distortion_model in ("none", "radtan", "equidistant")


def camera_line(camera: Camera) -> str:
    """`1 MODEL width height parameters`; for cameras with a COLMAP model only."""
    model, coefficients = "PINHOLE", list(camera.distortion)
    if camera.distortion_model == "equidistant":
        model = "OPENCV_FISHEYE"
    elif camera.is_distorted and len(coefficients) <= _WITHOUT_K3:
        model = "OPENCV"
    elif camera.is_distorted and len(coefficients) == _WITH_K3 and coefficients[-1] == 0.0:
        model, coefficients = "OPENCV", coefficients[:_WITHOUT_K3]
    elif camera.is_distorted:
        model, coefficients = "FULL_OPENCV", coefficients + [0.0] * (8 - len(coefficients))
    else:
        coefficients = []
    centre = (camera.cx + _CENTRE_TO_CORNER_PX, camera.cy + _CENTRE_TO_CORNER_PX)
    values = (camera.fx, camera.fy, *centre, *coefficients)
    return f"1 {model} {camera.width} {camera.height} {' '.join(repr(float(v)) for v in values)}"


def write_model(
    folder: Path,
    camera: Camera,
    names: Sequence[str],
    world_from_cam: Floats,
    points: ModelPoints,
    observations: ModelObservations,
) -> None:
    """Write a model of K images, M points and N observations.

    Args:
        folder: output folder, created if missing; a model in it is replaced.
        camera: the camera of all images.
        names: names of the K image files, without white space.
        world_from_cam: (K, 4, 4).
        points: the M points.
        observations: the N observations.

    Raises:
        OSError: the files cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    image, point, xy = observations
    first = np.searchsorted(image, np.arange(len(names) + 1))
    index_in_image = np.arange(len(image)) - first[image]
    corner_xy = xy + _CENTRE_TO_CORNER_PX
    _write(folder / "cameras.txt", iter([camera_line(camera)]))
    _write(folder / "images.txt", _image_lines(names, world_from_cam, first, corner_xy, point))
    _write(folder / "points3D.txt", _point_lines(points, image, point, index_in_image))


def _write(path: Path, lines: Iterator[str]) -> None:
    with path.open("w", encoding="utf-8") as stream:
        stream.writelines(f"{line}\n" for line in lines)


def _image_lines(
    names: Sequence[str], world_from_cam: Floats, first: Ints, xy: Floats, point: Ints
) -> Iterator[str]:
    for row, (name, pose) in enumerate(zip(names, inverse(world_from_cam), strict=True)):
        x, y, z, w = quat_xyzw_from_rotation(pose[:3, :3]).tolist()
        values = (w, x, y, z, *pose[:3, 3].tolist())
        yield f"{row + 1} {' '.join(map(repr, values))} 1 {name}"
        observed = slice(first[row], first[row + 1])
        pairs = zip(xy[observed].tolist(), point[observed].tolist(), strict=True)
        yield " ".join(f"{u:.3f} {v:.3f} {number + 1}" for (u, v), number in pairs)


def _point_lines(
    points: ModelPoints, image: Ints, point: Ints, index_in_image: Ints
) -> Iterator[str]:
    xyz, grey, error_px = points
    order = np.argsort(point, kind="stable")
    tracks = np.column_stack([image[order] + 1, index_in_image[order]])
    first = np.searchsorted(point[order], np.arange(len(xyz) + 1))
    for row, (position, level, error) in enumerate(
        zip(xyz.tolist(), grey.tolist(), error_px.tolist(), strict=True)
    ):
        track = " ".join(map(str, tracks[first[row] : first[row + 1]].ravel().tolist()))
        x, y, z = map(repr, position)
        yield f"{row + 1} {x} {y} {z} {level} {level} {level} {error:.4f} {track}"
