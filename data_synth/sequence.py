"""Makes a whole stereo recording with ground truth, all of it or nothing."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from data_synth.motion.spline import CameraWalk, walk_around
from data_synth.scene.render import camera_rays, render
from data_synth.scene.shutter import still
from data_synth.worlds.room import make_room
from data_synth.writers import euroc
from vo.errors import ConfigError, OutputError
from vo.geometry.transforms import inverse, make_transform
from vo.types import Bytes, Camera, Floats, Floats32, Ints, Rig, Trajectory

VERSION = 1  # to be raised when the same arguments give other images
BASELINE_M = 0.12
FIRST_STAMP_NS = 1_700_000_000_000_000_000

_FRAMES_AHEAD = 3
_PNG_LEVEL = 1

OnFrame = Callable[[int, int], None]


def stereo_rig(width: int, height: int) -> Rig:
    """Two ideal pinhole cameras side by side, with a horizontal field of view of 84.5 degrees."""
    focal = 0.55 * width
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    return Rig(camera, camera, make_transform(np.eye(3), np.array([-BASELINE_M, 0.0, 0.0])))


def body_from_cam0() -> Floats:
    """The body looks along x with z up; cam0 sits ahead of and beside its origin."""
    rotation = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return make_transform(rotation, np.array([0.05, 0.06, 0.02]))


def make_sequence(
    folder: Path | str,
    *,
    seconds: float = 8.0,
    fps: float = 15.0,
    width: int = 640,
    height: int = 400,
    seed: int = 0,
    noise: float = 2.0,
    on_frame: OnFrame | None = None,
) -> None:
    """Write a stereo walk around a furnished room in the EuRoC layout, with the true poses.

    The same arguments give the same bytes. The folder appears when it is complete.

    Args:
        folder: where to write; it must be missing or empty.
        seconds: length; a walk of 8 s or more ends where it starts.
        fps: frames per second.
        width: of the images, in pixels.
        height: of the images, in pixels.
        seed: of the room, the walk and the noise.
        noise: standard deviation of the noise in grey levels of 255.
        on_frame: called with the frames done and their total.

    Raises:
        ConfigError: a number that no recording can have.
        OutputError: the folder is not empty or cannot be written.
    """
    _check(seconds, fps, width, height, noise)
    stamps_s = np.arange(max(1, round(seconds * fps))) / fps
    path = walk_around(seed, seconds)
    with _whole_folder(Path(folder)) as partial:
        rig = stereo_rig(width, height)
        euroc.write_cameras(partial, rig, body_from_cam0(), fps)
        stamps_ns = FIRST_STAMP_NS + np.round(stamps_s * 1e9).astype(np.int64)
        _write_tables(partial, path, stamps_s, stamps_ns)
        poses = path.world_from_cam0(stamps_s)
        _write_images(partial, rig, poses, stamps_ns, seed, noise, on_frame)


def _check(seconds: float, fps: float, width: int, height: int, noise: float) -> None:
    for name, value, least, most in (
        ("seconds", seconds, 0.0, 3600.0),
        ("fps", fps, 0.0, 1000.0),
        ("width", width, 15, 8192),
        ("height", height, 15, 8192),
        ("noise", noise, -1e-9, 255.0),
    ):
        if not least < value <= most:
            raise ConfigError(f"{name} is {value}; give more than {least:g} and at most {most:g}")


@contextmanager
def _whole_folder(folder: Path) -> Iterator[Path]:
    """A folder beside that takes the name of `folder` at the end, or vanishes."""
    partial = folder.parent / f".{folder.name}.partial-{os.getpid()}"
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise OutputError(f"{folder} is not an empty folder; give another or remove it")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        yield partial
        os.replace(partial, folder)
    except OSError as error:
        raise OutputError(f"{folder} cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _write_tables(folder: Path, path: CameraWalk, stamps_s: Floats, stamps_ns: Ints) -> None:
    cam0_from_body = inverse(body_from_cam0())
    cam0 = path.world_from_cam0(stamps_s)
    step = 1e-4
    before, after = (path.world_from_cam0(stamps_s + s) @ cam0_from_body for s in (-step, step))
    velocity = (after[:, :3, 3] - before[:, :3, 3]) / (2.0 * step)
    truth = Trajectory(stamps_ns, cam0)
    euroc.write_truth(folder, stamps_ns, cam0 @ cam0_from_body, velocity, truth)
    for camera in (0, 1):
        euroc.write_stamps(folder, camera, stamps_ns)


def _write_images(
    folder: Path,
    rig: Rig,
    poses: Floats,
    stamps_ns: Ints,
    seed: int,
    noise: float,
    on_frame: OnFrame | None,
) -> None:
    world = make_room(seed)
    rays = camera_rays(rig.cam0)
    assert rig.cam1_from_cam0 is not None
    cam_from_cam0 = (np.eye(4), rig.cam1_from_cam0)
    pending: list[list[Future[None]]] = []
    with ThreadPoolExecutor() as pool:
        for index, (stamp, world_from_cam0) in enumerate(zip(stamps_ns, poses, strict=True)):
            pending.append([])
            for camera in (0, 1):
                world_from_cam = world_from_cam0 @ inverse(cam_from_cam0[camera])
                image = render(world, rays, still(world_from_cam), pool).image
                file = euroc.image_path(folder, camera, int(stamp))
                rng = np.random.default_rng([seed, 2, index, camera])
                pending[-1].append(pool.submit(_save, file, image, noise, rng))
            if len(pending) > _FRAMES_AHEAD:  # so that memory stays small where disks are slow
                _finish(pending.pop(0))
            if on_frame is not None:
                on_frame(index + 1, len(poses))
        for frame in pending:
            _finish(frame)


def _finish(frame: list[Future[None]]) -> None:
    for future in frame:
        future.result()


def _save(file: Path, image: Floats32, noise: float, rng: np.random.Generator) -> None:
    _, data = cv2.imencode(
        ".png", grey_levels(image, noise, rng), [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL]
    )
    file.write_bytes(data.tobytes())


def grey_levels(image: Floats32, noise: float, rng: np.random.Generator) -> Bytes:
    """What a sensor makes of radiance 0…1: Gaussian noise, then whole grey levels."""
    grey = image * np.float32(255.0)
    if noise > 0.0:
        grey += np.float32(noise) * rng.standard_normal(image.shape, dtype=np.float32)
    return np.asarray(np.clip(np.round(grey), 0.0, 255.0), dtype=np.uint8)
