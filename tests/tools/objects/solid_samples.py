"""A solid object in rendered rooms: a recording around it, and images with and without it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from data_synth.scene.builder import Builder
from data_synth.scene.lighting import bake_lighting
from data_synth.scene.render import camera_rays, render
from data_synth.scene.shutter import static_shutter
from data_synth.scene.solids import Kind, Lamp, Lighting
from data_synth.scene.world import World
from data_synth.worlds import prints, textures
from vo.base.geometry.transforms import make_transform
from vo.base.types import Bytes, Camera, Floats

CAMERA = Camera(640, 480, 560.0, 560.0, 319.5, 239.5)
BASELINE_M = 0.1
SIZE_M = (0.30, 0.22, 0.34)  # of the box
TABLE_M = 0.7
MIDDLE = np.array([0.0, 0.0, TABLE_M + 0.2])  # of the object in the frame of the world
_FACES = ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1))
_LIGHT = dict(ambient=0.6, points_per_m=8.0, max_points=48)
CALIBRATION = """cam0: &cam
  resolution: [640, 480]
  intrinsics: [560.0, 560.0, 319.5, 239.5]
  distortion_model: none
  distortion: []
cam1: *cam
cam1_from_cam0: [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""


def room(number: int, *, object_yaw: float | None = 0.0, kind: int = 0) -> World:
    """A room with a table, with the object on it unless its yaw is None; other kinds look alike."""
    build = Builder(np.random.default_rng((8, number)))
    walls = (textures.bricks, textures.plaster, textures.planks, textures.bricks)
    for n, (x, y) in enumerate(((3.1, 0.0), (0.0, 3.1), (-3.1, 0.0), (0.0, -3.1))):
        size = (0.2, 6.4, 2.8) if x else (6.4, 0.2, 2.8)
        build.add((x, y, 1.4), size, build.paint(walls[(n + number) % 4]), density=180.0)
        for spot in (-1.8, -0.4, 1.1, 2.2):
            at = (x * 0.96, spot, 1.5) if x else (spot, y * 0.96, 1.5)
            wide = (0.02, 0.8, 0.6) if x else (0.8, 0.02, 0.6)
            build.add(at, wide, build.paint(textures.poster, (256, 256)), density=None)
    floor = build.paint((textures.wood, textures.planks, textures.rug)[number % 3])
    build.add((0.0, 0.0, -0.1), (6.4, 6.4, 0.2), floor, density=180.0)
    cloth = build.paint((textures.fabric, textures.wood, textures.carton)[number % 3])
    build.add((0.0, 0.0, TABLE_M - 0.02), (1.3, 1.3, 0.04), cloth, 0.2, density=300.0)
    for n in range(6):  # things on the floor
        turn = n * 1.05 + number
        at = (1.9 * np.cos(turn), 1.9 * np.sin(turn), 0.25)
        build.add(at, (0.5, 0.4, 0.5), build.paint(textures.carton), turn, density=300.0)
    if object_yaw is not None:
        _add_object(build, object_yaw, kind)
    lamps = (Lamp((0.6 - number % 3, 0.4, 2.6)),)
    return bake_lighting(build.world(), Lighting(lamps=lamps, **_LIGHT))


def _add_object(build: Builder, yaw: float, kind: int) -> None:
    """A box with five printed faces and a cylinder on top of it."""
    rng, build.rng = build.rng, np.random.default_rng((9, kind))
    cosine, sine = np.cos(yaw), np.sin(yaw)
    middle = TABLE_M + SIZE_M[2] / 2
    core = np.array(SIZE_M) - 0.004
    build.add((0.0, 0.0, middle), tuple(core), build.paint(textures.plaster), yaw)
    for n, (axis, sign) in enumerate(_FACES):
        offset, size = np.zeros(3), core.copy()
        offset[axis], size[axis] = sign * core[axis] / 2, 0.004
        x, y, z = offset
        paint = (prints.notices, textures.poster, prints.label)[n % 3]
        face = build.paint(paint, (256, 256))
        at = (float(cosine * x - sine * y), float(sine * x + cosine * y), middle + z)
        build.add(at, tuple(size), face, yaw, density=None)
    x, y = 0.05 * cosine, 0.05 * sine
    can = build.paint(textures.poster, (128, 256))
    top = TABLE_M + SIZE_M[2] + 0.05
    build.add((x, y, top), (0.14, 0.14, 0.1), can, yaw, density=None, kind=Kind.CYLINDER)
    build.rng = rng


def looking(position: Floats, target: Floats, roll: float = 0.0) -> Floats:
    """world_from_cam of a camera at a place that looks at another one."""
    ahead = (target - position) / np.linalg.norm(target - position)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    return make_transform(np.column_stack([right, down, ahead]) @ turn, position)


def around(angle: float, distance: float = 1.0, height: float = 0.35) -> Floats:
    """world_from_cam on a circle about the object."""
    place = np.array([distance * np.cos(angle), distance * np.sin(angle), height])
    return looking(MIDDLE + place, MIDDLE)


def view(world: World, world_from_cam: Floats, seed: int = 0, noise: float = 2.0) -> Bytes:
    """An image (480, 640) uint8 of the camera there."""
    with ThreadPoolExecutor(2) as pool:
        image = render(world, camera_rays(CAMERA), static_shutter(world_from_cam), pool).image
    grey = 255.0 * image + np.random.default_rng((7, seed)).normal(0.0, noise, image.shape)
    return np.asarray(np.clip(np.rint(grey), 0, 255), dtype=np.uint8)


def write_orbit(folder: Path, frames: int, turn_deg: float = 360.0) -> list[Floats]:
    """A stereo recording around the object, and world_from_cam of its frames."""
    world = room(0)
    right_from_left = make_transform(np.eye(3), np.array([BASELINE_M, 0.0, 0.0]))
    poses = []
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
    for n, angle in enumerate(np.deg2rad(np.linspace(0.0, turn_deg, frames))):
        pose = around(float(angle), 1.05 + 0.1 * np.sin(3 * angle), 0.3 + 0.15 * np.cos(2 * angle))
        poses.append(pose)
        for side, shift in (("left", np.eye(4)), ("right", right_from_left)):
            image = view(world, pose @ shift, 2 * n + (side == "right"))
            cv2.imwrite(str(folder / side / f"{n:06d}.png"), image)
    (folder / "calibration.yaml").write_text(CALIBRATION, "utf-8")
    (folder / "times.txt").write_text("".join(f"{n / 15:.6f}\n" for n in range(frames)), "utf-8")
    return poses
