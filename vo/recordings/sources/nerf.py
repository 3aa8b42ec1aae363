"""NeRF layout: transforms.json with the camera and a pose of each image, and folders of images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.base.faults import Fault
from vo.base.types import Floats, Mode, Trajectory
from vo.recordings.formats.calibration.nerf import PosedImage, read_nerf_poses
from vo.recordings.sources.assembly import RecordingContents, calibration_reader, first_existing
from vo.recordings.sources.folder import assign_stamps, find_times_file
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import IMAGE_SUFFIXES, Shot, is_image_name, list_images

_NAMES = ("transforms.json", "transforms_train.json")


def gather_nerf(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List the images of a transforms.json in natural order of their names.

    Where all of them are in one folder, images of that folder without a pose are included. Stamps
    are those of a plain folder of images. The unit of length of the ground truth is any.
    """
    file = path if path.is_file() else first_existing([path / name for name in _NAMES])
    if file is None:
        raise SourceError(f"{path} has no {' or '.join(_NAMES)}")
    posed = read_nerf_poses(file)
    files = [_image_file(file, image) for image in posed]
    folders = {image.parent for image in files}
    images = list_images(files[0].parent) if len(folders) == 1 else files
    times = find_times_file(file.parent, files[0].parent)
    faults: list[Fault] = []
    shots, _ = assign_stamps(images, files[0].parent, times, faults)
    poses = {image: one.world_from_cam for image, one in zip(files, posed, strict=True)}
    return RecordingContents(
        name=file.resolve().parent.name,
        format="nerf",
        left=shots,
        calibrate=calibration_reader(calibration, [file]),
        read_truth=lambda _: _truth(shots, poses),
        faults=faults,
    )


def _image_file(file: Path, image: PosedImage) -> Path:
    """The image of a frame; Blender leaves the suffix out."""
    path = file.parent / image.name
    if not path.resolve().is_relative_to(file.parent.resolve()):
        raise SourceError(
            f"{file}: image {image.name[:200]} is outside of the folder {file.parent}; run on the "
            f"folder of the images with `calibration={file}`"
        )
    if is_image_name(path.name):
        return path
    found = (path.with_name(path.name + suffix) for suffix in IMAGE_SUFFIXES)
    return next((each for each in found if each.is_file()), path.with_name(path.name + ".png"))


def _truth(shots: Sequence[Shot], poses: dict[Path, Floats]) -> Trajectory | None:
    known = [
        (shot.stamp_ns, poses[shot.image.path])
        for shot in shots
        if isinstance(shot.image, ImageFile) and shot.image.path in poses
    ]
    if not known:
        return None
    stamps = np.array([stamp_ns for stamp_ns, _ in known], dtype=np.int64)
    return Trajectory(stamps, np.stack([pose for _, pose in known]))
