"""Rendered scenes with known objects, for `scripts/objects`: exact outlines, cover and light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from data_synth.scene.builder import Rng
from data_synth.worlds import prints, textures
from vo.base.types import Bools, Bytes, Camera, Floats, Floats32

CAMERA = Camera(1280, 960, 1200.0, 1200.0, 639.5, 479.5)
LIGHTS = ("plain", "dark", "bright", "gradient", "lamp", "flat")
_STORED_PX = 400  # longer side of a stored image
_WIDTH_M = 0.2  # of every object
_SUPERSAMPLED = 2

_PRINTS: tuple[Callable[[Rng, tuple[int, int]], Floats32], ...] = (
    textures.poster,
    prints.notices,
    textures.poster,
    prints.machine,
    textures.poster,
    textures.carton,
    textures.poster,
    textures.rug,
    textures.poster,
    prints.notices,
)
_GROUNDS = (textures.planks, textures.plaster, textures.fabric, textures.bricks, textures.wood)


class TrueObject(NamedTuple):
    """A flat object."""

    name: str
    texture: Floats32  # (H, W) in 0 to 1, of twice the resolution of the stored image
    image: Bytes  # (h, w) uint8, the stored image
    width_m: float = _WIDTH_M


class TrueInstance(NamedTuple):
    """An object in a scene."""

    name: str
    outline: Floats  # (4, 2) pixels of its corners, from the upper left one, clockwise
    cam_from_object: Floats  # (4, 4) metres; the object's frame is at its upper left corner
    visible: float  # ratio of its area that is inside the image and not covered
    scale: float  # size in the scene relative to the stored image
    tilt_deg: float  # angle between its normal and the optical axis


@dataclass(frozen=True, eq=False)
class Scene:
    """An image with what it shows."""

    image: Bytes
    instances: tuple[TrueInstance, ...]
    light: str


class SceneOptions(NamedTuple):
    """How scenes are made."""

    count: int = 2
    cover: tuple[float, float] = (0.0, 0.0)  # minimum and maximum ratio that is covered
    scale: tuple[float, float] = (0.3, 3.0)  # minimum and maximum size relative to the stored image
    tilt_deg: float = 45.0  # maximum angle out of the plane
    light: str = "plain"  # one of `LIGHTS`
    clutter: int = 14


def make_objects(count: int, seed: int = 1) -> list[TrueObject]:
    """Different textured objects."""
    made = []
    for n in range(count):
        rng = np.random.default_rng((seed, n))
        shape = (800, 560) if n % 2 else (600, 800)
        make = _PRINTS[n % len(_PRINTS)]
        texture = make(rng, (shape[0] // 2, shape[1] // 2))  # large print
        texture = cv2.resize(texture, shape[::-1], interpolation=cv2.INTER_CUBIC)
        size = tuple(round(side * _STORED_PX / max(shape)) for side in shape[::-1])
        small = cv2.resize(texture, size, interpolation=cv2.INTER_AREA)
        image = np.clip(np.rint(255.0 * small + rng.normal(0.0, 2.0, small.shape)), 0, 255)
        made.append(TrueObject(f"object{n:04d}", texture, image.astype(np.uint8)))
    return made


def make_scene(objects: list[TrueObject], seed: int, options: SceneOptions) -> Scene:
    """A scene of some objects that do not hide each other, among things that are in no database."""
    rng = np.random.default_rng((7, seed))
    canvas = _ground(rng)
    for _ in range(options.clutter):
        _place_clutter(rng, canvas)
    placed: list[tuple[TrueObject, Floats, float, float]] = []
    taken = np.zeros(canvas.shape, bool)
    for number in range(options.count):
        chosen = objects[int(rng.integers(len(objects)))]
        # The first one has any size, further ones fit beside it.
        largest = options.scale[1] if number == 0 else min(1.0, options.scale[1])
        span = np.log(options.scale[0]), np.log(largest)
        for _ in range(30):
            scale = float(np.exp(rng.uniform(*span)))
            pose, tilt = _pose(rng, chosen, scale, options.tilt_deg)
            corners = _corners(chosen, pose)
            area = _filled(corners, canvas.shape)
            inside = corners.min() >= 4 and (corners <= np.array([1275, 955])).all()
            if (area & taken).any() or (not inside and scale < 1.5):
                continue
            if _inside_ratio(corners, area) < 0.75:
                continue
            _paint(canvas, chosen.texture, corners)
            taken |= area
            placed.append((chosen, pose, scale, tilt))
            break
    covered = np.zeros(canvas.shape, bool)
    for chosen, pose, _, _ in placed:
        ratio = float(rng.uniform(*options.cover))
        _cover(rng, canvas, covered, _filled(_corners(chosen, pose), canvas.shape), ratio)
    instances = []
    for chosen, pose, scale, tilt in placed:
        corners = _corners(chosen, pose)
        area = _filled(corners, canvas.shape)
        seen = np.count_nonzero(area & ~covered) / max(_area(corners), 1.0)
        instances.append(TrueInstance(chosen.name, corners, pose, min(seen, 1.0), scale, tilt))
    return Scene(_developed(rng, canvas, options.light), tuple(instances), options.light)


def _pose(rng: Rng, chosen: TrueObject, scale: float, max_tilt_deg: float) -> tuple[Floats, float]:
    """cam_from_object whose centre is somewhere in the image, and the tilt in degrees."""
    height, width = chosen.image.shape
    unit = chosen.width_m / width
    depth = CAMERA.fx * unit / scale
    reach = 0.5 * scale * float(np.hypot(width, height)) * 0.8
    centre = [
        rng.uniform(min(reach, side / 2), max(side - reach, side / 2))
        for side in (CAMERA.width, CAMERA.height)
    ]
    ray = np.array([(centre[0] - CAMERA.cx) / CAMERA.fx, (centre[1] - CAMERA.cy) / CAMERA.fy, 1.0])
    turn = rng.uniform(0.0, 2.0 * np.pi)
    axis = rng.uniform(0.0, 2.0 * np.pi)
    tilt = np.deg2rad(rng.uniform(0.0, max_tilt_deg))
    in_plane = cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0]
    out_of_plane = cv2.Rodrigues(tilt * np.array([np.cos(axis), np.sin(axis), 0.0]))[0]
    pose = np.eye(4)
    pose[:3, :3] = out_of_plane @ in_plane
    middle = unit * np.array([width / 2, height / 2, 0.0])
    pose[:3, 3] = depth * ray - pose[:3, :3] @ middle
    return pose, float(np.rad2deg(tilt))


def _corners(chosen: TrueObject, cam_from_object: Floats) -> Floats:
    height, width = chosen.image.shape
    unit = chosen.width_m / width
    flat = unit * np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]], float)
    points = flat @ cam_from_object[:3, :3].T + cam_from_object[:3, 3]
    pixels = points[:, :2] / points[:, 2:]
    return np.asarray(pixels * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy))


def _area(corners: Floats) -> float:
    return float(cv2.contourArea(corners.astype(np.float32)))


def _inside_ratio(corners: Floats, area: Bools) -> float:
    return float(np.count_nonzero(area)) / max(_area(corners), 1.0)


def _filled(corners: Floats, shape: tuple[int, ...]) -> Bools:
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 1)
    return np.asarray(mask, dtype=bool)


def _paint(canvas: Floats32, texture: Floats32, corners: Floats) -> None:
    """Draw a texture between four corners, without aliasing."""
    size = np.sqrt(_area(corners) / (texture.shape[0] * texture.shape[1]))
    while size < 0.4:  # else texels are skipped
        texture = cv2.resize(texture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        size *= 2.0
    height, width = texture.shape
    low = np.floor(corners.min(axis=0) - 2).clip(0).astype(int)
    high = np.ceil(corners.max(axis=0) + 3).astype(int)
    high = np.minimum(high, np.array(canvas.shape[::-1]))
    if (high - low <= 0).any():
        return
    n = _SUPERSAMPLED
    source = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32) - 0.5
    target = (corners - low + 0.5) * n - 0.5
    matrix = cv2.getPerspectiveTransform(source, target.astype(np.float32))
    extent = tuple((n * (high - low)).tolist())
    drawn = cv2.warpPerspective(texture, matrix, extent, flags=cv2.INTER_LINEAR)
    cover = cv2.warpPerspective(np.ones_like(texture), matrix, extent, flags=cv2.INTER_LINEAR)
    small = tuple((high - low).tolist())
    drawn = cv2.resize(drawn, small, interpolation=cv2.INTER_AREA)
    cover = cv2.resize(cover, small, interpolation=cv2.INTER_AREA)
    part = canvas[low[1] : high[1], low[0] : high[0]]
    part[:] = drawn + (1.0 - cover) * part


def _ground(rng: Rng) -> Floats32:
    made = _GROUNDS[int(rng.integers(len(_GROUNDS)))](rng, (CAMERA.height, CAMERA.width))
    return np.ascontiguousarray(made, dtype=np.float32)


def _place_clutter(rng: Rng, canvas: Floats32) -> None:
    """Something that is in no database, somewhere."""
    kinds = (textures.poster, prints.label, textures.books, textures.carton, prints.carton_stack)
    texture = kinds[int(rng.integers(len(kinds)))](rng, (220, 300))
    size = rng.uniform(60.0, 320.0)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    centre = rng.uniform((0, 0), (CAMERA.width, CAMERA.height))
    box = size * np.array([[-0.5, -0.37], [0.5, -0.37], [0.5, 0.37], [-0.5, 0.37]])
    box = box * rng.uniform(0.6, 1.0, 2) + 0.06 * size * rng.normal(size=(4, 2)).clip(-1, 1)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    _paint(canvas, texture, box @ turn.T + centre)


def _cover(rng: Rng, canvas: Floats32, covered: Bools, area: Bools, ratio: float) -> None:
    """Hide a part of an area behind other things."""
    total = np.count_nonzero(area)
    rows, columns = np.nonzero(area)
    if ratio <= 0 or not total:
        return
    span = float(np.sqrt(total))
    for _ in range(400):
        missing = ratio * total - np.count_nonzero(covered & area)
        if missing < 0.01 * total:
            return
        side = float(np.clip(np.sqrt(missing), 0.08 * span, 0.45 * span))
        at = int(rng.integers(total))
        box = side * np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        corners = box + (columns[at], rows[at])
        new = _filled(corners, canvas.shape) & area & ~covered
        if np.count_nonzero(new) > 1.1 * missing + 20:
            continue
        kinds = (textures.fabric, textures.poster, textures.wood, textures.carton)
        texture = kinds[int(rng.integers(len(kinds)))](rng, (200, 200))
        _paint(canvas, texture, corners)
        covered |= _filled(corners, canvas.shape)


def _developed(rng: Rng, canvas: Floats32, light: str) -> Bytes:
    """The image of a camera: light, blur of the lens, noise, 8 bits."""
    height, width = canvas.shape
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    sigma, image = 0.008, canvas.copy()
    if light == "dark":
        image, sigma = 0.3 * image, 0.012
    elif light == "bright":
        image = 1.4 * image
    elif light == "gradient":
        angle = rng.uniform(0.0, 2.0 * np.pi)
        ramp = (np.cos(angle) * (u / width - 0.5) + np.sin(angle) * (v / height - 0.5)) * 1.4
        image = image * (0.65 + 0.5 * ramp).clip(0.15, 1.2)
    elif light == "lamp":
        at = rng.uniform((0.2, 0.2), (0.8, 0.8)) * (width, height)
        spot = np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / (2.0 * 220.0**2))
        image = 0.45 * image + 0.8 * spot * image + 0.15 * spot
    elif light == "flat":
        image = 0.4 + 0.3 * image
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    image = image.clip(0.0, 1.0) ** np.float32(1.0 / 1.2)
    image += rng.normal(0.0, sigma, image.shape).astype(np.float32)
    return np.asarray(np.clip(np.rint(255.0 * image), 0, 255), dtype=np.uint8)
