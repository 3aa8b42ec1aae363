"""Short recordings in memory: read from disk, changed by faults, and written again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from vo.base.types import Floats, Ints, Rig, Trajectory
from vo.recordings.formats.trajectory import write_tum
from vo.recordings.sources.registry import open_source

Image = Any  # (H, W) uint8 or uint16
ImageMap = Callable[[Image, int, int], Image | None]  # image, camera, frame

_KALIBR_DISTORTION = {"none": "none", "radtan": "radtan", "equidistant": "equidistant"}
ROOM = {"world": "room", "motion": "handheld", "camera": "pinhole", "seconds": 6, "seed": 3}


@dataclass(frozen=True, eq=False)
class Clip:
    """A recording in memory."""

    name: str
    # for each camera the images of all frames, None where one is missing
    images: tuple[list[Image | None], ...]
    # for each camera (N,) times that are written; of a missing image too
    stamps_ns: tuple[Ints, ...]
    rig: Rig  # the calibration that is written
    truth: Floats  # (N, 4, 4) true world_from_cam0 of each frame, NaN where it is not known
    # true depth images (H, W) of cam0 in metres, where the recording has them
    depth: tuple[Floats, ...] = ()

    def __len__(self) -> int:
        return len(self.truth)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the images."""
        return self.rig.cam0.height, self.rig.cam0.width

    @property
    def baseline_px(self) -> float:
        """Disparity at a depth of one metre, in pixels."""
        assert self.rig.cam1_from_cam0 is not None
        return float(self.rig.cam0.fx * np.linalg.norm(self.rig.cam1_from_cam0[:3, 3]))

    @property
    def truth_of_frames(self) -> Floats:
        """The true poses of the frames that a run reads, (M, 4, 4): those with a left image."""
        return np.asarray(self.truth[[image is not None for image in self.images[0]]])

    def left(self) -> Clip:
        """The left camera alone."""
        rig = Rig(self.rig.cam0)
        return replace(self, images=self.images[:1], stamps_ns=self.stamps_ns[:1], rig=rig)

    def mapped(self, function: ImageMap) -> Clip:
        """Every image replaced by `function(image, camera, frame)`."""
        images = tuple(
            [None if x is None else function(x, c, i) for i, x in enumerate(camera)]
            for c, camera in enumerate(self.images)
        )
        return replace(self, images=images)


Fault = Callable[[Clip], Clip]


class Clips:
    """The clean recordings, by names such as `hall stereo`."""

    FOLDERS = {
        "kitti06": "kitti06_stereo_000-050",
        "kitti07": "kitti07_mono_000-099",
        "kitti_raw": "kitti_raw_stereo_000-099",
        "hall": "rendered_hall_stereo",
    }

    def __init__(self, data: Path, cache: Path) -> None:
        self._data, self._cache = data, cache
        self._load = lru_cache(maxsize=2)(self._read)

    def get(self, name: str) -> Clip | None:
        """The clip of this name, None if its recording does not exist."""
        recording, mode = name.split()
        clip = self._load(recording)
        return clip.left() if clip and mode == "mono" and clip.rig.is_stereo else clip

    def _read(self, recording: str) -> Clip | None:
        if recording == "room":
            return read_clip(self._room(), "room")
        folder = self._data / self.FOLDERS[recording]
        return read_clip(folder, recording) if folder.is_dir() else None

    def _room(self) -> Path:
        from data_synth.cache import cached_sequence
        from data_synth.recipe import Recipe

        recipe = Recipe.model_validate({**ROOM, "depth": True})
        return cached_sequence(recipe, self._cache, "robustness_room")


def read_clip(folder: Path, name: str) -> Clip:
    """Read a recording with ground truth."""
    source = open_source(folder)
    frames = list(source.frames())
    cameras = len(source.rig.cameras)
    images = tuple([frame.images[c] for frame in frames] for c in range(cameras))
    stamps = np.array([frame.stamp_ns for frame in frames], dtype=np.int64)
    assert source.ground_truth is not None
    depth: tuple[Floats, ...] = ()
    if (folder / "depth").is_dir():
        depth = tuple(cv2.imread(str(f), -1) for f in sorted((folder / "depth").glob("*.tiff")))
    truth = true_poses(source.ground_truth, stamps)
    return Clip(name, images, (stamps,) * cameras, source.rig, truth, depth)


def true_poses(truth: Trajectory, stamps_ns: Ints) -> Floats:
    """Poses at these times, between true ones in a straight line; NaN outside of the truth.

    Rotations are those of the nearest true pose.
    """
    poses = np.full((len(stamps_ns), 4, 4), np.nan)
    margin = 10_000_000  # ns, for stamps that were rounded
    inside = (stamps_ns >= truth.stamps_ns[0] - margin) & (
        stamps_ns <= truth.stamps_ns[-1] + margin
    )
    nearest = np.abs(truth.stamps_ns[None] - stamps_ns[inside, None]).argmin(axis=1)
    poses[inside] = truth.world_from_cam[nearest]
    for axis in range(3):
        poses[inside, axis, 3] = np.interp(
            stamps_ns[inside], truth.stamps_ns, truth.positions[:, axis]
        )
    return poses


def write_euroc(clip: Clip, folder: Path) -> Path:
    """Write the EuRoC layout with a Kalibr calibration; files are numbered, not named by time."""
    for number, (images, stamps) in enumerate(zip(clip.images, clip.stamps_ns, strict=True)):
        data = folder / "mav0" / f"cam{number}" / "data"
        data.mkdir(parents=True)
        rows = ["#timestamp [ns],filename"]
        for index, (image, stamp) in enumerate(zip(images, stamps.tolist(), strict=True)):
            if image is not None:
                write_png(data / f"{index:06d}.png", image)
                rows.append(f"{stamp},{index:06d}.png")
        (data.parent / "data.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    write_kalibr(folder / "camchain.yaml", clip.rig)
    known = np.isfinite(clip.truth[:, 0, 0])
    if (np.diff(clip.stamps_ns[0][known]) > 0).all():
        truth = Trajectory(clip.stamps_ns[0][known], clip.truth[known])
        write_tum(folder / "groundtruth.tum", truth)
    return folder


def write_kitti(clip: Clip, folder: Path, units_per_s: float = 1.0) -> Path:
    """Write the KITTI layout of a rectified pair or one camera, times in any unit."""
    for number, images in enumerate(clip.images):
        (folder / f"image_{number}").mkdir(parents=True)
        for index, image in enumerate(images):
            if image is not None:
                write_png(folder / f"image_{number}" / f"{index:06d}.png", image)
    camera = clip.rig.cam0
    lines = []
    for number in range(len(clip.images)):
        offset = -clip.baseline_px if number else 0.0
        p = [camera.fx, 0, camera.cx, offset, 0, camera.fy, camera.cy, 0, 0, 0, 1, 0]
        lines.append(f"P{number}: " + " ".join(repr(float(x)) for x in p))
    (folder / "calib.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    times = (clip.stamps_ns[0] - clip.stamps_ns[0][0]) * 1e-9 * units_per_s
    text = "".join(f"{t:.9f}\n" for t in times)
    (folder / "times.txt").write_text(text, encoding="utf-8")
    return folder


def write_kalibr(path: Path, rig: Rig) -> None:
    """Write a Kalibr camera chain."""
    content: dict[str, Any] = {}
    for number, camera in enumerate(rig.cameras):
        content[f"cam{number}"] = {
            "camera_model": "pinhole",
            "intrinsics": [float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy)],
            "distortion_model": _KALIBR_DISTORTION[camera.distortion_model]
            + ("5" if len(camera.distortion) == 5 else ""),
            "distortion_coeffs": [float(x) for x in camera.distortion],
            "resolution": [int(camera.width), int(camera.height)],
        }
    if rig.cam1_from_cam0 is not None:
        content["cam1"]["T_cn_cnm1"] = rig.cam1_from_cam0.tolist()
    path.write_text(yaml.safe_dump(content, default_flow_style=None), encoding="utf-8")


def write_png(path: Path, image: Image) -> None:
    """Write an image, quickly."""
    if not cv2.imwrite(str(path), image, (cv2.IMWRITE_PNG_COMPRESSION, 1)):
        raise SystemExit(f"error: {path} cannot be written")
