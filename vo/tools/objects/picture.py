"""Picture of an image with the outlines of the objects in it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from vo.base.types import Bytes, Floats
from vo.tools.drawing import check_picture, write_picture
from vo.tools.objects.stored_objects import FoundObject

_COLOURS = ((60, 200, 60), (40, 140, 255), (230, 120, 40), (200, 60, 200), (40, 210, 230))
_REACH = 4.0  # outlines are drawn up to so many image sizes away


def write_objects_picture(
    path: Path, image: Bytes, found: Sequence[FoundObject], tracks: Sequence[int]
) -> None:
    """Write the picture of `draw_objects`.

    `path`: PNG or JPEG file.

    Raises:
        OutputError: the file cannot be written.
    """
    check_picture(path)
    write_picture(path, draw_objects(image, found, tracks))


def draw_objects(image: Bytes, found: Sequence[FoundObject], tracks: Sequence[int]) -> Bytes:
    """The image (H, W, 3) BGR with outlines, names and confidences.

    `image`: (H, W) uint8. `tracks`: number of each, which gives the colour.
    """
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    thickness = max(1, round(max(image.shape) / 500))
    for each, track in zip(found, tracks, strict=True):
        colour = _COLOURS[track % len(_COLOURS)]
        corners = _drawable(each.outline, image.shape)
        if each.edges is None:
            cv2.polylines(canvas, [corners], True, colour, thickness, cv2.LINE_AA)
            # The upper side of the stored image is thicker, so that the orientation can be seen.
            cv2.line(canvas, corners[0], corners[1], colour, 3 * thickness, cv2.LINE_AA)
        else:
            edges = [_drawable(edge, image.shape) for edge in each.edges]
            cv2.polylines(canvas, edges, False, colour, thickness, cv2.LINE_AA)
        _label(canvas, f"{each.name} {each.confidence:.2f}", corners, colour, thickness)
    return np.asarray(canvas, dtype=np.uint8)


def _drawable(
    outline: Floats, shape: tuple[int, ...]
) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
    limit = _REACH * max(shape)
    return np.rint(np.clip(outline, -limit, limit)).astype(np.int32)


def _label(
    canvas: Bytes,
    text: str,
    corners: np.ndarray[tuple[int, int], np.dtype[np.int32]],
    colour: tuple[int, int, int],
    thickness: int,
) -> None:
    plain = text.encode("ascii", "replace").decode()
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.5 * thickness
    (width, height), below = cv2.getTextSize(plain, font, scale, thickness)
    rows, columns = canvas.shape[:2]
    at = corners.clip(0, (columns - 1, rows - 1)).min(axis=0)
    left = int(np.clip(at[0], 0, max(columns - width, 0)))
    top = int(np.clip(at[1], height + below, rows - below - 1))
    cv2.rectangle(canvas, (left, top - height - below), (left + width, top + below), colour, -1)
    cv2.putText(canvas, plain, (left, top), font, scale, (255, 255, 255), thickness, cv2.LINE_AA)
