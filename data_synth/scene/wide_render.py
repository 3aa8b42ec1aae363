"""Images of lenses that see behind them: resampled from six square pinhole images."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np

from data_synth.scene.render import Rendered, camera_rays, render
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.geometry.cameras import directions
from vo.base.geometry.transforms import make_transform
from vo.base.types import Camera, Floats, Floats32

_DENSITY = 1.25  # pixels of a face for one of the lens, where the lens has most
_MARGIN_PX = 4
_NO_FACE = -10.0  # pixel outside of a face

# Rotations cam_from_face: ahead, right, behind, left, below, above.
_FACES = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    ],
    dtype=np.float64,
)


@dataclass(frozen=True, eq=False)
class Face:
    """One pinhole image: pose (4, 4) in the camera's frame, rays, and where the lens has it.

    Attributes:
        at: (H, W, 2) float32 pixels of the face for those of the lens, outside of it for others.
        used: (H, W) whether the lens takes the pixel from this face.
    """

    cam_from_face: Floats
    rays: Floats
    at: Floats32
    used: Floats32


def sees_behind(camera: Camera) -> bool:
    """Whether the field of view is wider than 180 degrees, across the image or along it."""
    w, h = camera.width - 1.0, camera.height - 1.0
    edges = np.array([[0, camera.cy], [w, camera.cy], [camera.cx, 0], [camera.cx, h]])
    seen = directions(camera, edges)
    return bool(np.any(np.isnan(seen[:, 2]) | (seen[:, 2] < 0.0))) and camera.is_distorted


def faces_of(camera: Camera) -> tuple[Face, ...]:
    """The faces that a lens needs."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    seen = directions(camera, np.column_stack([u.ravel(), v.ravel()]))
    focal = _DENSITY * max(camera.fx, camera.fy)
    side = 2 * (int(focal) + _MARGIN_PX) + 1
    middle = (side - 1) / 2
    face_camera = Camera(side, side, focal, focal, middle, middle)
    nearest = np.argmax(seen @ _FACES[:, :, 2].T, axis=1)
    faces = []
    for number, turn in enumerate(_FACES):
        used = (nearest == number) & np.isfinite(seen[:, 0])
        if not used.any():
            continue
        local = seen[used] @ turn
        at = np.full((len(seen), 2), _NO_FACE, np.float32)
        at[used] = focal * local[:, :2] / local[:, 2:] + middle
        shape = camera.height, camera.width
        faces.append(
            Face(
                make_transform(turn, np.zeros(3)),
                camera_rays(face_camera),
                at.reshape(*shape, 2),
                used.reshape(shape).astype(np.float32),
            )
        )
    return tuple(faces)


def render_faces(
    world: World,
    faces: tuple[Face, ...],
    shutter_at: Callable[[Floats], Shutter],
    pool: ThreadPoolExecutor,
) -> Rendered:
    """Render a lens; `shutter_at` gives the shutter of a face from its pose in the camera."""
    image = np.zeros(faces[0].used.shape, np.float32)
    for face in faces:
        shown = render(world, face.rays, shutter_at(face.cam_from_face), pool).image
        sampled = cv2.remap(shown, face.at, None, cv2.INTER_CUBIC, None, cv2.BORDER_REPLICATE)
        image += face.used * np.maximum(sampled, 0.0)
    return Rendered(image, np.full(image.shape, np.inf, np.float32))
