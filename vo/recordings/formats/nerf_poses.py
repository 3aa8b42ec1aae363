"""Poses of images in NeRF's `transforms.json`, as instant-ngp, nerfstudio and Blender write it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.errors import CalibrationError, SourceError
from vo.base.types import Floats
from vo.recordings.formats.calibration.checks import make_transform
from vo.recordings.formats.calibration.document import load_document

_OPENGL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])
"""From a camera with y down and z forward to one with y up and z back."""


class PosedImage(NamedTuple):
    """An image and its pose.

    Attributes:
        name: path of the image, relative to the file, perhaps without suffix.
        world_from_cam: (4, 4), the camera with y down and z forward. The unit of length is any.
    """

    name: str
    world_from_cam: Floats


def read_nerf_poses(path: Path | str) -> list[PosedImage]:
    """Read all poses, in natural order of the names of the images."""
    path = Path(path)
    try:
        document = load_document(path)
    except CalibrationError as error:
        raise SourceError(str(error)) from error
    if document.problem:
        raise SourceError(f"{path} {document.problem}")
    frames = document.data.get("frames")
    if not isinstance(frames, list) or not frames:
        raise SourceError(f"{path} has no list `frames` with poses, as transforms.json of NeRF has")
    images = []
    for number, frame in enumerate(frames):
        where = f"{path}: frame {number}"
        if not isinstance(frame, Mapping) or not isinstance(frame.get("file_path"), str):
            raise SourceError(f"{where}: file_path is missing; it is the name of the image")
        try:
            pose = make_transform(f"{where}: transform_matrix", frame.get("transform_matrix"))
        except CalibrationError as error:
            raise SourceError(str(error)) from error
        name = frame["file_path"].replace("\\", "/")
        images.append(PosedImage(name, pose @ _OPENGL_FROM_CV))
    return sorted(images, key=lambda image: _natural_key(image.name))


def _natural_key(name: str) -> list[tuple[int, str]]:
    """A sort key that compares numbers in names by value."""
    parts = re.split(r"(\d+)", name)
    return [(int(part[:18]), "") if i % 2 else (0, part) for i, part in enumerate(parts)]
