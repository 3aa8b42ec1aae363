"""Records keyframes and points as a COLMAP model, with its images."""

from __future__ import annotations

import re
import shutil
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.errors import OutputError
from vo.base.files.bounded_files import read_bytes
from vo.base.geometry import cameras
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.rig_overlap import is_rig
from vo.base.geometry.transforms import inverse
from vo.base.records.snapshot import View
from vo.base.types import Bytes, Camera, Estimate, Floats, Floats32, Rig, Trajectory
from vo.outputs.recorders.map_spool import Model
from vo.outputs.recorders.ply import MapRecorder
from vo.outputs.recorders.reconstruction import Reconstruction, camera_of, pinhole_of
from vo.outputs.recorders.recorder import TakeSnapshot
from vo.recordings.formats.colmap import (
    MODEL_FILES,
    RIG_FILES,
    ModelPoints,
    ModelWriter,
    has_colmap_model,
)

_IMAGES, _MODELS = "images", "sparse"
_PARTIAL_SUFFIX = ".partial"


class ColmapRecorder(MapRecorder):
    """Writes `images/`, and again and again `sparse/0`, `sparse/1`, …; the final ones at the end.

    Each world is a model: a segment, or at the end all segments that loops have connected, because
    other relative poses are unknown. The one with most keyframes is first. Images are those used by
    the odometry: rectified in stereo, as recorded in mono (in colour if available). They are
    undistorted if COLMAP does not support the lens.

    `folder`: created if it is missing; models of an earlier run in it are removed, those of others
    are refused.
    """

    def __init__(self, folder: Path, store: Reconstruction | None = None) -> None:
        super().__init__(store)
        self._folder = folder
        self._images = ImageFolder(folder / _IMAGES)
        self._is_rectified = False
        self._names: dict[int, str] = {}
        self._frames = self._names  # keyframes without an image are left out
        self._camera: Camera | None = None
        self._further: dict[int, list[str | None]] = {}  # names of the other images of a rig
        self._first_from_others: list[Floats] = []
        self._maps: tuple[Floats32, Floats32] | None = None

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Create the folder.

        Raises:
            OutputError: the folder cannot be written to, or it has models or images of others.
        """
        self._is_rectified = is_rig(rig) or rectified_rig(rig).maps[0] is not None
        try:
            self._refuse_foreign_files()
            (self._folder / _IMAGES).mkdir(parents=True, exist_ok=True)
            self._store.open(self._folder)
            self._remove_models(from_number=0)
        except OSError as error:
            raise OutputError(
                f"cannot write to folder {self._folder}: {error.strerror or error}; "
                "choose another `colmap`"
            ) from error

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Add a frame; the image of a keyframe is written.

        Raises:
            OSError: the disk is full.
        """
        view = snapshot().view
        if self._camera is None:
            self._camera, self._maps = _output_camera(view)
        if estimate.is_keyframe:
            self._names[estimate.frame_index] = self._write_image(estimate, view)
            self._write_further(estimate.frame_index, view)
        super().record(estimate, snapshot)

    def _write_image(self, estimate: Estimate, view: View) -> str:
        image = view.image0
        if self._maps is not None:
            undistorted = cv2.remap(image, *self._maps, cv2.INTER_LINEAR)
            image = np.asarray(undistorted, dtype=np.uint8)
        is_recorded = self._maps is None and not self._is_rectified
        return self._images.add(estimate.frame_index, view.path, image, is_recorded=is_recorded)

    def _write_further(self, frame_index: int, view: View) -> None:
        """Write the images of the other cameras of a rig, in a folder for each."""
        names: list[str | None] = []
        first_from_cam0 = inverse(np.eye(4) if (p := view.cam0_from_image0) is None else p)
        self._first_from_others = [first_from_cam0 @ o.cam0_from_image for o in view.further]
        stem = self._names[frame_index].rpartition(".")[0]
        for each in view.further:
            names.append(None if each.image is None else f"{each.name}/{stem}.png")
            if each.image is not None:
                file = self._folder / _IMAGES / str(names[-1])
                file.parent.mkdir(exist_ok=True)
                file.unlink(missing_ok=True)  # a link would be followed
                file.write_bytes(_png(each.image))
        self._further[frame_index] = names

    def _write(self, models: list[Model]) -> None:
        written = [model for model in models if model.point_count] or models[:1]
        for number, model in enumerate(written):
            folder = self._folder / _MODELS / str(number)
            partial = folder.with_name(f"{number}{_PARTIAL_SUFFIX}")
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir(parents=True)
            try:
                self._write_model(partial, model)
                shutil.rmtree(folder, ignore_errors=True)
                partial.rename(folder)
            except OSError:
                shutil.rmtree(partial, ignore_errors=True)
                raise
        self._remove_models(from_number=len(written))

    def _models(self) -> list[Path]:
        """Folders of models of this run, or of an earlier one."""
        folders = (self._folder / _MODELS).glob("*")
        return [each for each in folders if _number(each).isdecimal()]

    def _refuse_foreign_files(self) -> None:
        models, images = self._models(), self._folder / _IMAGES
        foreign = [each for each in models if each.is_symlink() or not is_own_model(each)]
        foreign += [each for each in (images, self._folder / _MODELS) if each.is_symlink()]
        if not models and images.is_dir() and any(images.iterdir()):
            foreign = [images]
        if foreign:
            raise OutputError(
                f"{foreign[0]} is not of an earlier run and would be replaced; "
                "choose another `colmap`"
            )

    def _remove_models(self, from_number: int) -> None:
        """Remove models of an earlier run or moment."""
        for old in self._models():
            if int(_number(old)) >= from_number and is_own_model(old):
                shutil.rmtree(old)

    def _write_model(self, folder: Path, model: Model) -> None:
        assert self._camera is not None
        is_pinhole = self._maps is not None
        # Of recorded images, with the correction of the lens that was estimated during the run.
        camera = self._camera if is_pinhole else model.camera
        count = len(model.frame_index)
        with closing(ModelWriter(folder, camera, self._first_from_others)) as writer:
            for image, points in model.walk():
                frame, pose = int(model.frame_index[image.keyframe]), model.world_from_image0
                xy = image.xy
                if is_pinhole:
                    xy = _undistorted(model.camera, self._camera, xy)
                pose = pose[image.keyframe]
                writer.add_image(image.keyframe, self._names[frame], pose, xy, image.point)
                writer.add_frame(image.keyframe, pose, self._further.get(frame, ()), count)
                if points is not None:
                    writer.add_points(ModelPoints(*points))


def _number(folder: Path) -> str:
    return folder.name.removesuffix(_PARTIAL_SUFFIX)


def is_own_model(folder: Path) -> bool:
    """Whether a model was written here: text files, without the comment that COLMAP begins with."""
    if not {each.name for each in folder.iterdir()} <= {*MODEL_FILES, *RIG_FILES}:
        return False
    cameras_file = folder / MODEL_FILES[0]
    return not cameras_file.is_file() or not cameras_file.read_bytes().startswith(b"#")


def _output_camera(view: View) -> tuple[Camera, tuple[Floats32, Floats32] | None]:
    """The camera of the written images, and maps of `cv2.remap` if they are to be undistorted."""
    camera, pinhole = camera_of(view), pinhole_of(view)
    if has_colmap_model(camera):
        return camera, None
    u, v = np.meshgrid(np.arange(pinhole.width), np.arange(pinhole.height))
    rays = cameras.normalise(pinhole, np.column_stack([u.ravel(), v.ravel()]).astype(np.float64))
    maps: NDArray[np.float32] = cameras.distort(camera, rays).astype(np.float32)
    maps = np.nan_to_num(maps, nan=-1.0).reshape(pinhole.height, pinhole.width, 2)
    return pinhole, (np.ascontiguousarray(maps[..., 0]), np.ascontiguousarray(maps[..., 1]))


def _undistorted(lens: Camera, pinhole: Camera, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    return cameras.distort(pinhole, cameras.normalise(lens, xy))


_COLOUR_DIMENSIONS = 3
_MAX_BYTES = 512 * 2**20


class ImageFolder:
    """Writes images under their names in the recording.

    `folder`: must exist; files of the same name are replaced.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._names: set[str] = set()

    def add(self, frame_index: int, path: Path | None, image: Bytes, *, is_recorded: bool) -> str:
        """Write the image of a frame; its file name, without white space.

        `frame_index`: number of the frame. `path`: file of its recorded image, None without one.
        `is_recorded`: whether `image` equals the recorded image, so that a colour image can be
        copied instead.

        Raises:
            OSError: the file cannot be written, or the folder is that of the recording.
        """
        if path is not None and path.parent.resolve() == self._folder.resolve():
            raise OSError(f"{self._folder} contains the images of the recording")
        # A link may lead to a file that is no part of the recording: only its pixels are written.
        may_copy = is_recorded and path is not None and not path.is_symlink()
        recorded = _in_colour(path) if may_copy and path is not None else None
        suffix = ".png" if recorded is None else recorded.suffix
        stem = "frame" if path is None else re.sub(r"\s", "_", path.stem)
        name = f"{stem}{suffix}"
        if path is None or name in self._names:
            name = f"{stem}_{frame_index:06d}{suffix}"
        self._names.add(name)
        target = self._folder / name
        target.unlink(missing_ok=True)  # a link would be followed
        if recorded is None:
            target.write_bytes(_png(image))
        else:
            shutil.copyfile(recorded, target)
        return name


def _in_colour(path: Path) -> Path | None:
    """The file, if it is a readable colour image of 8 bits."""
    try:
        data = np.frombuffer(read_bytes(path, _MAX_BYTES), dtype=np.uint8)
        image: NDArray[np.generic] | None = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except (OSError, cv2.error):
        return None
    if image is None or image.ndim != _COLOUR_DIMENSIONS or image.dtype != np.uint8:
        return None
    return path


def _png(image: Bytes) -> bytes:
    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert done
    return bytes(data.tobytes())
