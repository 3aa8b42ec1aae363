"""Picture of two images side by side, with their matches and epipolar lines."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from vo.base.geometry.cameras import distort, ideal_pixels
from vo.base.geometry.transforms import skew
from vo.base.types import Bools, Bytes, Camera, Floats, Ints
from vo.tools.drawing import check_picture, write_picture
from vo.tools.pairs.image_pair import ImagePair
from vo.tools.pairs.simple_motions import inverse_matrix
from vo.tools.pairs.two_view_records import ModelKind

_MAX_WIDTH = 2400  # of the picture; larger images are reduced
_GAP = 8
# BGR, of Okabe and Ito's palette, which colour-blind readers can tell apart.
_FEATURE, _INLIER, _OUTLIER = (170, 170, 170), (233, 180, 86), (0, 94, 213)
_LINES = 16  # epipolar lines of each image
_STEPS = 400  # points along an epipolar line, which a lens bends


def write_pair_picture(
    path: Path,
    images: tuple[Bytes, Bytes],
    pair: ImagePair,
    *,
    epipolar: bool = False,
    best: int | None = None,
) -> None:
    """Write the picture of `draw_pair`.

    `path`: PNG or JPEG file.

    Raises:
        OutputError: the file cannot be written.
    """
    check_picture(path)
    write_picture(path, draw_pair(images, pair, epipolar=epipolar, best=best))


def draw_pair(
    images: tuple[Bytes, Bytes],
    pair: ImagePair,
    *,
    epipolar: bool = False,
    best: int | None = None,
) -> Bytes:
    """Both images side by side: features grey, inliers blue, other matches orange.

    `images`: (H, W) uint8. `epipolar`: draw lines of some inliers in either image, in the colour of
    their point in the other one. `best`: draw so many matches only, those with the most similar
    descriptors.
    """
    canvas = _Canvas(images)
    for side, keypoints in enumerate(pair.keypoints):
        canvas.dots(side, np.asarray(keypoints.xy, dtype=np.float64), _FEATURE, 1)
    drawn = np.zeros(len(pair.inlier), bool)
    drawn[np.argsort(pair.matches.score, kind="stable")[:best]] = True
    for colour, rows in ((_OUTLIER, drawn & ~pair.inlier), (_INLIER, drawn & pair.inlier)):
        canvas.connect(pair.first_xy[rows], pair.second_xy[rows], colour)
    if epipolar:
        _draw_lines(canvas, pair)
    return canvas.pixels


def fundamental_of(pair: ImagePair) -> Floats | None:
    """The fundamental matrix (3, 3) of ideal pixels; None if there are no epipolar lines."""
    fit, pose, cameras = pair.fit, pair.pose, pair.cameras
    if fit is None:
        return None
    if fit.kind is ModelKind.FUNDAMENTAL:
        return fit.matrix
    if cameras is None or pose is None or not pose.has_translation:
        return None
    motion = pose.second_from_first
    essential = skew(motion[:3, 3]) @ motion[:3, :3]
    first, second = (inverse_matrix(camera.matrix) for camera in cameras)
    return np.asarray(second.T @ essential @ first)


class _Canvas:
    """Two images side by side in colour, and drawing in the pixels of either."""

    def __init__(self, images: tuple[Bytes, Bytes]) -> None:
        width = sum(image.shape[1] for image in images)
        height = max(image.shape[0] for image in images)
        self.scale = min(1.0, (_MAX_WIDTH - _GAP - 2) / width, _MAX_WIDTH / height)
        small = [self._reduced(image) for image in images]
        self.left = (0, small[0].shape[1] + _GAP)
        self.size = [(each.shape[1], each.shape[0]) for each in small]
        rows = max(each.shape[0] for each in small)
        self.pixels = np.full((rows, self.left[1] + small[1].shape[1], 3), 255, dtype=np.uint8)
        for left, each in zip(self.left, small, strict=True):
            self.pixels[: each.shape[0], left : left + each.shape[1]] = each[:, :, None]
        self.thickness = 2 if self.scale < 1.0 else 1

    def _reduced(self, image: Bytes) -> Bytes:
        if self.scale == 1.0:
            return image
        size = [max(1, round(length * self.scale)) for length in image.shape[1::-1]]
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)

    def _at(self, side: int, xy: Floats) -> Ints:
        at = (xy + 0.5) * self.scale - 0.5 + (self.left[side], 0)
        return np.asarray(np.rint(at), dtype=np.int64)

    def dots(self, side: int, xy: Floats, colour: tuple[int, int, int], radius: int) -> None:
        """Circles at pixels (N, 2) of an image."""
        for point in self._at(side, xy).tolist():
            cv2.circle(self.pixels, point, radius, colour, 1, cv2.LINE_AA)

    def connect(self, first: Floats, second: Floats, colour: tuple[int, int, int]) -> None:
        """Lines from pixels (N, 2) of one image to those of the other."""
        for one, other in zip(
            self._at(0, first).tolist(), self._at(1, second).tolist(), strict=True
        ):
            cv2.line(self.pixels, one, other, colour, 1, cv2.LINE_AA)
        for side, xy in enumerate((first, second)):
            self.dots(side, xy, colour, 2)

    def curve(self, side: int, xy: Floats, colour: tuple[int, int, int]) -> None:
        """A curve along pixels (N, 2) of an image, inside of it."""
        left, size = self.left[side], self.size[side]
        part = self.pixels[: size[1], left : left + size[0]]
        inside = np.isfinite(xy).all(axis=1) & (np.abs(xy) < 1e5).all(axis=1)
        pieces = np.split(xy, np.flatnonzero(~inside))
        for piece in pieces:
            points = piece[np.isfinite(piece).all(axis=1) & (np.abs(piece) < 1e5).all(axis=1)]
            if len(points) > 1:
                shifted = self._at(side, points) - (left, 0)
                cv2.polylines(
                    part, [shifted.astype(np.int32)], False, colour, self.thickness, cv2.LINE_AA
                )


def _draw_lines(canvas: _Canvas, pair: ImagePair) -> None:
    fundamental = fundamental_of(pair)
    if fundamental is None:
        return
    rows = _spread(pair.inlier)
    cameras = pair.cameras or (None, None)
    for number, row in enumerate(rows.tolist()):
        colour = _hue(number / max(len(rows), 1))
        points = (pair.first_xy[row], pair.second_xy[row])
        for side, matrix in ((1, fundamental), (0, fundamental.T)):
            ideal = _ideal(cameras[1 - side], points[1 - side])
            line = matrix @ (*ideal, 1.0)
            xy = _along(line, cameras[side], pair.sizes[side])
            canvas.curve(side, xy, colour)
        for side, point in enumerate(points):
            canvas.dots(side, point[None], colour, 5)


def _spread(inlier: Bools) -> Ints:
    """Rows of some inliers."""
    rows = np.flatnonzero(inlier)
    if len(rows) <= _LINES:
        return rows
    return rows[np.linspace(0, len(rows) - 1, _LINES).astype(np.int64)]


def _ideal(camera: Camera | None, point: Floats) -> Floats:
    return point if camera is None else np.asarray(ideal_pixels(camera, point[None])[0])


def _along(line: Floats, camera: Camera | None, size: tuple[int, int]) -> Floats:
    """Pixels (N, 2) along a line a u + b v + c = 0 of ideal pixels, as the lens bends it."""
    a, b, c = line / max(float(np.hypot(line[0], line[1])), 1e-30)
    middle = np.array(size, dtype=np.float64) / 2.0
    nearest = middle - (a * middle[0] + b * middle[1] + c) * np.array([a, b])
    reach = 4.0 * float(np.hypot(*size))  # a wide lens sees far beyond the ideal image
    steps = np.linspace(-reach, reach, _STEPS)[:, None]
    ideal = nearest + steps * np.array([-b, a])
    if camera is None:
        return np.asarray(ideal)
    rays = (ideal - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    return distort(camera, rays)


def _hue(share: float) -> tuple[int, int, int]:
    pixel = np.array([[[round(179 * share), 230, 255]]], dtype=np.uint8)
    blue, green, red = cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0].tolist()
    return blue, green, red
