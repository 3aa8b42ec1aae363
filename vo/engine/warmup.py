"""Compilation of all functions that the odometry needs, before its first frame."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from vo.base.compiling import machine_code, processes, store
from vo.base.compiling.function import announce_compilation, compiled_here
from vo.base.config import Config, load_config
from vo.base.geometry.projection import Intrinsics, PixelObservations
from vo.base.geometry.rectification import rectified_rig
from vo.base.images.png import decode_grey
from vo.base.scheduling import available_cores
from vo.base.types import Bytes, Camera, Frame, ImuNoise, Rig
from vo.base.version import __version__
from vo.engine.geometry.rolling_shutter import Velocity, disparity_at_middle_row

_PACKAGE = Path(__file__).parents[1]
_ROOMS_WITH_KERNELS = (
    "base/compiling",
    "base/geometry",
    "base/images",
    "engine/backend",
    "engine/features",
    "engine/frontend",
    "engine/geometry",
    "engine/inertial",
    "engine/learned",
    "engine/mapping",
    "engine/places",
    "engine/tracking",
    "engine/loop_verification",
)
_SIZE = (240, 320)  # of the images, rows and columns
_FOCAL_PX = 200.0
_DISTORTION = (-0.1, 0.01, 0.0, 0.0)
_BASELINE_M = 0.1
# Two textured planes: a single plane leaves the pose of the second camera ambiguous.
_DISPARITIES_PX = (8, 4)
_FRAMES = 12

# What is compiled apart: no recording needs all of it.
_PARTS = ("stereo", "mono", "inertial")
# Of a second process, which begins with what tracking needs last.
_PROGRAM = """
from vo.engine.warmup import use_apart
for part in {parts!r}:
    use_apart(part)
"""

_is_running = False


def parts_of(rig: Rig, *, inertial: bool) -> list[str]:
    """The parts that recordings by such cameras need."""
    return ["stereo" if rig.is_stereo else "mono", *["inertial"] * inertial]


def is_warm(parts: Iterable[str] = _PARTS) -> bool:
    """Whether `warm_up` has been completed for this version of the code and this processor."""
    return all(_stamp(part).exists() for part in parts)


def warm_up(make_odometry: Callable[[Rig, Config], Any], parts: Iterable[str] = _PARTS) -> bool:
    """Compile the functions of the odometry, unless that was done before.

    Runs the odometry on generated images, so that exactly the functions and signatures that it
    uses are compiled. The machine code is cached on disk; whether, when or where this function is
    called makes no difference to results.

    `make_odometry`: the class `Odometry`, whose constructor calls this function. Returns whether
    anything had to be compiled.
    """
    global _is_running
    if _is_running or is_warm(parts):
        return False
    compiled_before = compiled_here()
    _is_running, helper = True, None
    try:
        if not machine_code.is_supported():  # numba's own cache does not report compilations
            announce_compilation()
        elif available_cores() > 1:
            helper = processes.start(_PROGRAM.format(parts=tuple(parts)))
        for part in parts:
            _use(part, make_odometry)
            _save_stamp(part)
    finally:
        if helper is not None:
            helper.kill()  # what it has not compiled yet nobody needs any more
            helper.wait()
        _is_running = False
    return compiled_here() != compiled_before


def _use(part: str, make_odometry: Callable[[Rig, Config], Any]) -> None:
    if part != "inertial":
        _run(make_odometry, next(rig for rig in _rigs() if rig.is_stereo == (part == "stereo")))
    use_apart(part)


def use_apart(part: str) -> None:
    """Call the functions of a part that can be called without a run, with any values."""
    if part == "inertial":
        return _use_inertial_samples()
    _use_poses()
    _use_pose_graph()
    _use_whole_path()
    _use_screening()
    _use_fixed_content()
    _use_rolling_shutter()
    _, packed = cv2.imencode(".png", _image(_texture(), 0.0))
    decode_grey(packed.tobytes())


def _run(make_odometry: Callable[[Rig, Config], Any], rig: Rig) -> None:
    """Run the odometry, in this process alone."""
    odometry = make_odometry(rig, load_config(overrides=["threads=1", "memory.loops=true"]))
    try:
        for frame in _frames(rig.is_stereo):
            odometry.track(frame)
        odometry.finish()
    finally:
        odometry.close()


def _rigs() -> Iterator[Rig]:
    cam1_from_cam0 = np.eye(4)
    cam1_from_cam0[0, 3] = -_BASELINE_M
    rows, columns = _SIZE
    center = (columns / 2, rows / 2)
    camera = Camera(columns, rows, _FOCAL_PX, _FOCAL_PX, *center, "radtan", _DISTORTION)
    yield Rig(camera, camera, cam1_from_cam0)
    yield Rig(camera)


def _use_inertial_samples() -> None:
    """Call what only a recording with inertial samples needs, with any values."""
    from vo.engine.inertial.estimation import estimate_states, first_prior
    from vo.engine.inertial.preintegration import Interval, preintegrate, rotation_of
    from vo.engine.inertial.states import States, Steps

    zero, zeros, noise = np.zeros(3), np.zeros((2, 3)), ImuNoise(1e-3, 1e-5, 1e-2, 1e-4)
    interval = Interval(np.array([0.0, 0.1]), zeros, zeros)
    rotation_of(interval, zero)
    motion = np.eye(4)
    measured = preintegrate(interval, zero, zero, noise)
    covariance, is_visual = np.eye(6)[None], np.ones(1, dtype=bool)
    steps = Steps(
        *(np.full(1, 0.1), (measured,), motion[None], covariance, is_visual),
        is_metric=False,
        imu_from_cam=motion,
    )
    states = States(np.stack([np.eye(3)] * 2), zeros, zeros, zeros, zeros, np.zeros(2))
    prior = first_prior(states.rows(slice(0, 1)), is_metric=False)
    estimate_states(states, steps, prior, noise)


def _use_rolling_shutter() -> None:
    """Call what only images of a rolling shutter need, with any values."""
    rig = replace(rectified_rig(next(_rigs())), readout_s=0.01)
    still = Velocity(np.zeros(3), np.zeros(3))
    disparity_at_middle_row(rig, np.zeros((1, 2)), np.ones(1), still)


def _use_fixed_content() -> None:
    """Call what only a recording of which most has moved needs."""
    from vo.engine.frontend.image_fixed import ImageFixedDetector
    from vo.engine.frontend.image_gradients import displacement, gradients_of

    detector, images = ImageFixedDetector(), [_image(_texture(), n) for n in range(12)]
    for image in images:
        detector.update((image,), _SIZE)
    now, other = gradients_of(images[0]), gradients_of(images[1])
    displacement(now, other.u, other.v)


def _use_screening() -> None:
    """Call what only a recording that sees places again needs, with any values."""
    from vo.engine.loop_verification.landmark_search import LandmarkSearch, keyframe_pair
    from vo.engine.loop_verification.screening import Screening
    from vo.engine.mapping.keyframe import FrameId
    from vo.engine.places.records import PATCH_PX, Place, PlaceKey, PlaceLandmarks
    from vo.engine.places.vocabulary import DESCRIPTOR_BYTES
    from vo.engine.places.vocabulary_file import built_in_vocabulary

    random, count = np.random.default_rng(0), 20
    xyz = random.uniform((-1, -1, 4), (1, 1, 6), (count, 3)).astype(np.float32)
    descriptor = random.integers(0, 256, (count, DESCRIPTOR_BYTES), dtype=np.uint8)
    zeros = np.zeros(count, np.float32)
    landmarks = PlaceLandmarks(
        *(np.arange(count), xyz, xyz[:, :2], zeros + np.float32(0.01), descriptor),
        *(np.zeros(count, np.int32), zeros, np.zeros((count, PATCH_PX, PATCH_PX), np.uint8)),
    )
    of_path = PlaceKey(0, 0), FrameId(0, 0, 0), True, np.eye(4), np.eye(6)
    place = Place(*of_path, descriptor, landmarks, _image(_texture(), 0.0))
    camera = next(_rigs()).cam0
    Screening(built_in_vocabulary(), scale_factor=1.44).passes(place, place, camera)
    LandmarkSearch(1.44).by_relation(keyframe_pair(place, [place], camera), np.eye(4), 1.0)


def _use_poses() -> None:
    """Call what the pose of each frame and a lens need, for a camera that stands still."""
    from vo.engine.backend.lens_adjustment import Lens, undistorted
    from vo.engine.geometry.patch_prediction import predict_patches
    from vo.engine.geometry.pnp import refine_pose
    from vo.engine.geometry.surfaces import inverse_depth_slopes

    rows, ones = np.arange(20), np.ones(20)
    xyz, first = np.ones((20, 3)), np.zeros(20, np.int64)
    intrinsics = Intrinsics(_FOCAL_PX, _FOCAL_PX, 0.0, 0.0)
    seen = PixelObservations(xyz[:, :2] * _FOCAL_PX, ones, ones, 1.0)
    refine_pose(np.eye(4), xyz, seen, intrinsics, _FOCAL_PX)
    inverse_depth_slopes(xyz[:, :2], ones, rows)
    undistorted(xyz[:, :2], Lens(_FOCAL_PX, 0.0, 0.0))
    predict_patches(xyz, xyz, first, rows, first, np.eye(4)[None], intrinsics)


def _use_whole_path() -> None:
    """Call what only the end of a run needs, for a camera that moves by 0.1 m."""
    from vo.engine.backend import loop_adjustment as path
    from vo.engine.backend.window_problem import WindowProblem

    poses, config = np.tile(np.eye(4), (3, 1, 1)), load_config().smoothing
    poses[:, 0, 3] = 0.1 * np.arange(3)
    xyz = np.random.default_rng(0).uniform((-1, -1, 4), (1, 1, 6), (20, 3))
    seen = xyz - poses[:, None, :3, 3]
    problem = WindowProblem(
        Intrinsics(_FOCAL_PX, _FOCAL_PX, 0.0, 0.0),
        _BASELINE_M,
        1.0,
        poses,
        np.arange(3) == 0,
        xyz,
        np.repeat(np.arange(3), 20),
        np.tile(np.arange(20), 3),
        (_FOCAL_PX * seen[..., :2] / seen[..., 2:]).reshape(-1, 2),
        (_FOCAL_PX * _BASELINE_M / seen[..., 2]).reshape(-1),
        np.ones(60),
    )
    found = path.adjust_path(problem, path.NO_MOTIONS, config)
    if found is not None:
        path.path_covariance(path.path_information(problem, found, path.NO_MOTIONS, config))
    path.calibration_step(problem, config)


def _use_pose_graph() -> None:
    """Call what only a recording with loops needs, for two poses."""
    from vo.engine.backend.graph_problem import Edges
    from vo.engine.backend.robust_graph import optimise

    edge = Edges(np.zeros(1, int), np.ones(1, int), np.eye(4)[None], np.eye(7)[None])
    optimise(np.stack([np.eye(4)] * 2), np.zeros(1, int), edge, edge)


def _frames(stereo: bool) -> Iterator[Frame]:
    """Images of a camera that moves to the right by half a baseline from frame to frame."""
    texture = _texture()
    for index in range(_FRAMES):
        images = [_image(texture, (index + 2 * right) / 2) for right in range(2)]
        yield Frame(index, index * 100_000_000, tuple(images if stereo else images[:1]))


def _texture() -> Bytes:
    rows, columns = _SIZE
    coarse = np.random.default_rng(0).integers(0, 256, (rows // 4, columns), dtype=np.uint8)
    return np.repeat(np.repeat(coarse, 4, axis=0), 4, axis=1)


def _image(texture: Bytes, baselines: float) -> Bytes:
    """The planes, the far one above, from a position given in baselines to the right."""
    rows, columns = _SIZE
    image = np.empty(_SIZE, np.uint8)
    halves = (slice(rows // 2, rows), slice(rows // 2))
    for half, disparity in zip(halves, _DISPARITIES_PX, strict=True):
        begin = round(baselines * disparity)
        image[half] = texture[half, begin : begin + columns]
    return image


@lru_cache
def _digest() -> str:
    """Hash of the version, the rooms with compiled functions, the compiler and the processor.

    Of files the size and the time of the last change; reading all takes 5 ms at every start.
    """
    parts = [__version__, machine_code.toolchain()]
    for room in _ROOMS_WITH_KERNELS:
        files = sorted(os.scandir(_PACKAGE / room), key=lambda file: file.name)
        about = ((file.name, file.stat()) for file in files if file.name.endswith(".py"))
        parts += [f"{name} {found.st_size} {found.st_mtime_ns}" for name, found in about]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _stamp(part: str) -> Path:
    """File that exists once a part was compiled."""
    return store.folder() / f"warm-{part}-{_digest()}"


def _save_stamp(part: str) -> None:
    """Keep the stamp beside those of other versions; nothing if the folder cannot be written to."""
    stamp = _stamp(part)
    with suppress(OSError):
        store.create_folder()
        stamp.touch()
        store.remove_oldest(f"warm-{part}-*")
