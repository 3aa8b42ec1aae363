"""Writer of COLMAP models: posed images and points as text.

In COLMAP the corner of the top-left pixel is at (0, 0), so half a pixel is added here; poses are
cam_from_world with quaternions in the order w x y z; ids begin at 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse, quat_xyzw_from_rotation
from vo.base.types import Bytes, Camera, Floats, Ints

MODEL_FILES = ("cameras.txt", "images.txt", "points3D.txt")
RIG_FILES = ("rigs.txt", "frames.txt")
CENTRE_TO_CORNER_PX = 0.5
_WITHOUT_K3, _WITH_K3 = 4, 5  # numbers of radtan coefficients


def has_colmap_model(camera: Camera) -> bool:
    """Whether COLMAP has a camera model with this distortion."""
    return camera.distortion_model in ("none", "radtan", "equidistant")


def camera_model(camera: Camera) -> tuple[str, list[float]]:
    """Model and parameters; for cameras with a COLMAP model only."""
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
    centre = (camera.cx + CENTRE_TO_CORNER_PX, camera.cy + CENTRE_TO_CORNER_PX)
    return model, [float(v) for v in (camera.fx, camera.fy, *centre, *coefficients)]


def camera_line(camera: Camera, number: int = 1) -> str:
    """`1 MODEL width height parameters`; for cameras with a COLMAP model only."""
    model, values = camera_model(camera)
    return f"{number} {model} {camera.width} {camera.height} {' '.join(map(repr, values))}"


class ModelWriter:
    """Writes a model in parts.

    Args:
        folder: output folder, which must exist; a model in it is replaced.
        first_from_others: of a rig, poses of its other cameras, all with the same lens.

    Raises:
        OSError: here and in every method: the files cannot be written.
    """

    def __init__(
        self, folder: Path, camera: Camera, first_from_others: Sequence[Floats] = ()
    ) -> None:
        numbers = range(1, len(first_from_others) + 2)
        cameras = "".join(f"{camera_line(camera, number)}\n" for number in numbers)
        (folder / "cameras.txt").write_text(cameras, encoding="utf-8")
        self._first_from_others = first_from_others
        self._frames = None
        if first_from_others:
            sensors = [
                f"CAMERA {number} 1 {_pose_text(inverse(pose))}"
                for number, pose in enumerate(first_from_others, start=2)
            ]
            line = f"1 {len(numbers)} CAMERA 1 {' '.join(sensors)}\n"
            (folder / "rigs.txt").write_text(line, encoding="utf-8")
            self._frames = (folder / "frames.txt").open("w", encoding="utf-8")
        self._images = (folder / "images.txt").open("w", encoding="utf-8")
        self._points = (folder / "points3D.txt").open("w", encoding="utf-8")

    def add_image(
        self, row: int, name: str, world_from_cam: Floats, xy: Floats, point: Ints
    ) -> None:
        """Add an image.

        `row`: its number, from 0.
        `xy`: (N, 2) observations in pixels, the centre of the top-left pixel at (0, 0).
        `point`: (N,) numbers of their points, from 0.
        """
        pairs = zip((xy + CENTRE_TO_CORNER_PX).tolist(), point.tolist(), strict=True)
        observations = " ".join(f"{u:.3f} {v:.3f} {number + 1}" for (u, v), number in pairs)
        pose = _pose_text(inverse(world_from_cam))
        self._images.write(f"{row + 1} {pose} 1 {name}\n{observations}\n")

    def add_frame(
        self, row: int, world_from_cam: Floats, others: Sequence[str | None], count: int
    ) -> None:
        """Add the images of the other cameras of a rig, and that they and an image are one frame.

        `row`: that of the image of the first camera. `others`: names of the others by camera, None
        where one is missing. `count`: number of all images of the first camera.
        """
        if self._frames is None:
            return
        images = [(1, row + 1)]
        for camera, name in enumerate(others, start=2):
            if name is not None:
                number = (camera - 1) * count + row + 1
                pose = inverse(world_from_cam @ self._first_from_others[camera - 2])
                self._images.write(f"{number} {_pose_text(pose)} {camera} {name}\n\n")
                images.append((camera, number))
        listed = " ".join(f"CAMERA {camera} {number}" for camera, number in images)
        pose_text = _pose_text(inverse(world_from_cam))
        self._frames.write(f"{row + 1} 1 {pose_text} {len(images)} {listed}\n")

    def add_points(self, points: ModelPoints) -> None:
        """Add points."""
        tracks = np.column_stack([points.image + 1, points.in_image])
        first = points.first.tolist()
        columns = (points.number, points.xyz, points.grey, points.error_px)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        for row, (number, position, level, error) in enumerate(rows):
            track = " ".join(map(str, tracks[first[row] : first[row + 1]].ravel().tolist()))
            x, y, z = map(repr, position)
            self._points.write(
                f"{number + 1} {x} {y} {z} {level} {level} {level} {error:.4f} {track}\n"
            )

    def add_cloud(self, xyz: Floats, rgb: Bytes) -> None:
        """Add points (N, 3) with colours (N, 3) that no image is said to observe."""
        rows = zip(xyz.tolist(), rgb.tolist(), strict=True)
        for number, ((x, y, z), (r, g, b)) in enumerate(rows, start=1):
            self._points.write(f"{number} {x:.6g} {y:.6g} {z:.6g} {r} {g} {b} 0\n")

    def close(self) -> None:
        """Close the files."""
        try:
            self._images.close()
        finally:
            self._points.close()
            if self._frames is not None:
                self._frames.close()


def _pose_text(cam_from_world: Floats) -> str:
    """Quaternion w x y z and translation."""
    x, y, z, w = quat_xyzw_from_rotation(cam_from_world[:3, :3]).tolist()
    return " ".join(map(repr, (w, x, y, z, *cam_from_world[:3, 3].tolist())))


class ModelPoints(NamedTuple):
    """Some points of a model; M points, N observations.

    Attributes:
        number: (M,) from 0.
        xyz: (M, 3) in the world.
        grey: (M,) grey levels.
        error_px: (M,) mean reprojection errors.
        first: (M + 1,) where the observations of each point begin.
        image: (N,) rows of the images.
        in_image: (N,) rows of the observations in their image.
    """

    number: Ints
    xyz: Floats
    grey: Bytes
    error_px: Floats
    first: Ints
    image: Ints
    in_image: Ints
