"""TartanAir: rendered pairs with depth and poses, as version 1 and version 2 (front) have them.

Images are numbered from 0, and line i of the poses is that of image i. Version 2 has 10 frames per
second; version 1 has no times, and the same is assumed.

Source: Wang et al., "TartanAir: a dataset to push the limits of visual SLAM", IROS 2020;
`data_type.md` of tartanair_tools (version 1) and `docs/modalities.rst` of tartanairpy (version 2).
"""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, cast

import cv2
import numpy as np

from vo.base.errors import SourceError
from vo.base.files.bounded_files import read_bytes
from vo.base.geometry.transforms import make_transform
from vo.base.images.image_decoding import is_complete, quiet_opencv
from vo.base.images.image_header import MAX_PIXELS, stated_size
from vo.base.types import Camera, Floats32, Mode, Rig, Trajectory
from vo.recordings.formats.calibration import Calibration, ImageSize, read_calibration
from vo.recordings.formats.trajectory import read_tartanair
from vo.recordings.sources.assembly import RecordingContents
from vo.recordings.sources.images import ImageFile, Pixels, StoredImage
from vo.recordings.sources.listing import Shot, check_increasing, list_images, natural_key

_log = logging.getLogger(__name__)
_INTERVAL_NS = 100_000_000
_FOCAL_PX, _WIDTH, _BASELINE_M = 320.0, 640, 0.25
_SKY_M = 1000.0
"""Depth of what is too far to be a surface: the sky is a sphere, at 10,000 m for example."""
_MAX_BYTES = 2**26
_NO_DEPTH = (ValueError, EOFError, OverflowError, TypeError, SyntaxError, MemoryError, cv2.error)


class _Layout(NamedTuple):
    """Names of the cameras in folders and files, and of files of depth, and the images' height."""

    left: str
    right: str
    depth_suffix: str
    height: int


_LAYOUTS = _Layout("left", "right", ".npy", 480), _Layout("lcam_front", "rcam_front", ".png", 640)


@dataclass(frozen=True)
class DepthFile:
    """A `StoredImage` of depth in metres, 0 in the sky: `.npy`, or a PNG of the bytes of floats."""

    path: Path

    @property
    def name(self) -> str:
        """The path."""
        return str(self.path)

    def read(self, colour: bool = False) -> Pixels:
        """See `StoredImage.read`; depth is float32, whatever `colour` is."""
        try:
            data = read_bytes(self.path, _MAX_BYTES)
        except OSError as error:
            raise SourceError(
                f"depth image {self.path} cannot be read: {error.strerror or error}"
            ) from error
        try:
            decode = _npy_depth if self.path.suffix == ".npy" else _png_depth
            metres = decode(data)
        except _NO_DEPTH as error:
            raise SourceError(
                f"depth image {self.path} is damaged, or has other values than metres as floats"
            ) from error
        known = (metres > 0) & (metres < _SKY_M)  # False for NaN
        return cast("Pixels", np.where(known, metres, np.float32(0)))


def gather_tartanair(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List a trajectory; right images, depth and poses are optional."""
    path = path.resolve()
    layout = next((each for each in _LAYOUTS if (path / f"image_{each.left}").is_dir()), None)
    if layout is None:
        raise SourceError(f"{path} has neither image_left nor image_lcam_front")
    folder, right = path / f"image_{layout.left}", path / f"image_{layout.right}"
    depth = path / f"depth_{layout.left}"
    if layout is _LAYOUTS[0]:
        _log.warning("%s has no times: 10 frames per second are assumed", path)
    files = sorted(depth.glob(f"*_depth{layout.depth_suffix}"), key=natural_key)
    return RecordingContents(
        name=path.name,
        format="tartanair",
        left=_shots(list_images(folder), ImageFile),
        right=_shots(list_images(right), ImageFile) if right.is_dir() else None,
        depth=_shots(files, DepthFile) or None,
        calibrate=lambda size: _calibration(layout, calibration, size),
        read_truth=lambda _: _truth(path / f"pose_{layout.left}.txt"),
    )


def _shots(files: Sequence[Path], stored: Callable[[Path], StoredImage]) -> list[Shot]:
    """Images with the times of the numbers that their names begin with."""
    shots = []
    for file in files:
        number = re.match(r"\d{1,9}", file.name)
        if number is None:
            raise SourceError(f"{file}: its name does not begin with a number, as 000000_left.png")
        shots.append(Shot(int(number[0]) * _INTERVAL_NS, stored(file), f"file {file}"))
    check_increasing(shots)
    return shots


def _calibration(layout: _Layout, chosen: Path | None, size: ImageSize) -> Calibration:
    """The cameras of all trajectories, or those of a file; depth is in metres either way."""
    if chosen is not None:
        return replace(read_calibration(chosen, size), depth_per_metre=1.0)
    centre = _WIDTH / 2, layout.height / 2
    camera = Camera(_WIDTH, layout.height, _FOCAL_PX, _FOCAL_PX, *centre)
    cam1_from_cam0 = make_transform(np.eye(3), np.array([-_BASELINE_M, 0.0, 0.0]))
    return Calibration(Rig(camera, camera, cam1_from_cam0), depth_per_metre=1.0, kind="TartanAir")


def _truth(file: Path) -> Trajectory | None:
    """The poses, of which number i has the time of image i."""
    if not file.is_file():
        return None
    poses = read_tartanair(file).world_from_cam
    return Trajectory(np.arange(len(poses), dtype=np.int64) * _INTERVAL_NS, poses)


def _npy_depth(data: bytes) -> Floats32:
    array = np.load(io.BytesIO(data), allow_pickle=False)
    if array.ndim != 2 or array.dtype.kind != "f":
        raise ValueError("not an image of floats")
    return np.asarray(array, np.float32)


def _png_depth(data: bytes) -> Floats32:
    width, height = stated_size(data) or (0, 0)
    if not is_complete(data) or width * height > MAX_PIXELS:
        raise ValueError("cut off, or too large")
    with quiet_opencv:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.dtype != np.uint8 or pixels.shape[2:] != (4,):
        raise ValueError("not four bytes per pixel")
    return np.ascontiguousarray(pixels).view("<f4")[..., 0].astype(np.float32)
