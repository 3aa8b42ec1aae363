"""Models, and where they stand in the world of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.base.types import Floats
from vo.recordings.formats.mesh import Mesh

_AXIS_WIDTH = 0.06  # of axes, relative to their length
_AXIS_COLOURS = ((213, 94, 0), (0, 158, 115), (0, 114, 178))  # x, y, z
_UP: dict[str, Floats] = {
    # World (y down) from model, for the axis of the model that points up.
    "y": np.diag([1.0, -1.0, -1.0]),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "-y": np.eye(3),
}

_Z_UP_FROM_Y_DOWN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a model stands."""

    foot: Floats  # (3,) middle of its underside in the world
    size: float | None = None  # its largest extent there, None for its own
    up: str = "y"  # axis of the model that points up: `y`, `z` or `-y`
    world_up: str = "-y"  # axis of the world that points up: `z` where gravity is known, else `-y`


def axes() -> Mesh:
    """Axes x, y and z of unit length in red, green and blue, as bars."""
    vertices, triangles, rgb = [], [], []
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    for axis in range(3):
        size = np.full(3, _AXIS_WIDTH)
        size[axis] = 1.0
        first = 8 * axis
        vertices.append((corners - 0.5 * (np.arange(3) != axis)) * size)
        for a, b, c, d in quads:
            triangles += [[first + a, first + b, first + c], [first + a, first + c, first + d]]
        rgb += [_AXIS_COLOURS[axis]] * 8
    return Mesh(np.concatenate(vertices), np.array(triangles, np.int64), np.array(rgb, np.uint8))


def standing(mesh: Mesh, placement: Placement) -> Floats:
    """Vertices (V, 3) of a model on the origin, y down."""
    vertices = mesh.vertices @ _UP[placement.up].T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = float((high - low).max())
    factor = 1.0 if placement.size is None or extent == 0.0 else placement.size / extent
    foot = np.array([0.5 * (low[0] + high[0]), high[1], 0.5 * (low[2] + high[2])])
    return np.asarray((vertices - foot) * factor)


def placed(vertices: Floats, placement: Placement) -> Floats:
    """A standing model (V, 3) at its place in the world."""
    if placement.world_up == "z":
        vertices = vertices @ _Z_UP_FROM_Y_DOWN.T
    return np.asarray(vertices + placement.foot)
