"""Whether two keyframes look the same around their landmarks, where a relation predicts them.

In places that look alike many landmarks agree in everything. What tells them apart is what differs:
a door plate, a poster, what is behind a window. So windows of the small images are compared, also
where no feature was detected in the other image.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.frozen import frozen
from vo.base.geometry.transforms import inverse
from vo.base.types import Bools, Bytes, Camera, Floats, Floats32, Ints
from vo.engine.geometry import sim3
from vo.engine.loop_verification.landmark_search import KeyframePair
from vo.engine.loop_verification.merged_landmarks import MergedLandmarks, in_view
from vo.engine.loop_verification.patch_comparison import COMPARED_PX, largest_correlation
from vo.engine.places.records import Place

_SEARCHED_PX = COMPARED_PX + 2  # with shifts of a pixel
_MIN_CONTRAST = 4.0  # standard deviation of a window, grey levels
_MAX_SHIFT_PX = 1.0  # of a window, by twice the standard deviation of the landmark's depth
_SEEN_AGAIN, _DIFFERENT = 0.8, 0.5  # correlations
_MAX_LANDMARKS = 300  # of each keyframe, spread over all of them
_CONTROLS = 2  # keyframes of its own visit in which a landmark must look the same


class ComparedWindows(NamedTuple):
    """How many windows around landmarks of both keyframes were compared, and how many differ."""

    compared: int
    different: int


@frozen(eq=False)
class _View:
    """The image of a keyframe and the camera of its landmarks' pixels."""

    image: Bytes
    camera: Camera

    @property
    def scale(self) -> Floats:
        """(2,) pixels of the image for one of the camera."""
        height, width = self.image.shape
        return np.array([width / self.camera.width, height / self.camera.height])

    def pixels(self, xy: Floats) -> Floats:
        """Pixels (n, 2) of the camera as pixels of the image."""
        return np.asarray((xy + 0.5) * self.scale - 0.5)

    def holds(self, pixels: Floats) -> Bools:
        """(n,) whether windows around pixels are in the image."""
        margin, size = COMPARED_PX // 2, np.array(self.image.shape[::-1])
        return np.asarray(((pixels >= margin) & (pixels <= size - 1 - margin)).all(axis=1))

    def windows(self, pixels: Floats, size: Floats, rotation: Floats, side: int) -> Floats32:
        """(n, side, side) grey levels around pixels (n, 2), with turned steps of sizes (n,)."""
        if not len(pixels):
            return np.empty((0, side, side), np.float32)
        across = np.arange(side) - side // 2
        offsets = rotation @ np.stack(np.meshgrid(across, across)).reshape(2, -1)
        u, v = (
            (pixels[:, axis, None] + size[:, None] * offsets[axis]).astype(np.float32)
            for axis in (0, 1)
        )
        grey = cv2.remap(self.image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(grey.reshape(-1, side, side), np.float32)


def compare_images(
    pair: KeyframePair, earlier: Sequence[Place], later: Sequence[Place], relation: Floats
) -> ComparedWindows:
    """Windows of both keyframes that should look the same, and those that do not.

    Only landmarks that look the same in another keyframe of their own visit are compared: others
    are at edges of depth, or in the wrong position. `earlier` and `later` begin with the keyframe,
    others of its visit follow; `relation` is earlier_from_later.
    """
    first, second = pair.cameras
    forward = _correlations(
        pair.earlier, earlier, _View(later[0].thumbnail, second), first, sim3.inverse(relation)
    )
    back = _correlations(pair.later, later, _View(earlier[0].thumbnail, first), second, relation)
    found = np.concatenate([forward, back])
    return ComparedWindows(len(found), int((found < _DIFFERENT).sum()))


def _correlations(
    landmarks: MergedLandmarks,
    visit: Sequence[Place],
    there: _View,
    camera: Camera,
    there_from_here: Floats,
) -> Floats:
    """(n,) of windows around landmarks of the first keyframe of a visit that are reliable."""
    here = _View(visit[0].thumbnail, camera)
    windows = _windows_here(landmarks, here)
    found = _correlation(windows, here, there, there_from_here)
    windows, found = windows.select(np.isfinite(found)), found[np.isfinite(found)]
    again = np.full(len(found), np.nan)
    for other in visit[1 : 1 + _CONTROLS]:
        rows = np.flatnonzero(~(again <= _SEEN_AGAIN))  # the others differ already
        motion = inverse(other.odom_from_cam) @ visit[0].odom_from_cam
        more = _correlation(windows.select(rows), here, _View(other.thumbnail, camera), motion)
        again[rows] = np.fmin(again[rows], more)
    return np.asarray(found[again > _SEEN_AGAIN])


class _Windows(NamedTuple):
    """Landmarks (n,) of a keyframe, and what it shows around them."""

    xyz: Floats
    sigma: Floats
    grey: Floats32

    def select(self, rows: Ints | Bools) -> _Windows:
        """Some of them."""
        return _Windows(self.xyz[rows], self.sigma[rows], self.grey[rows])


def _windows_here(landmarks: MergedLandmarks, here: _View) -> _Windows:
    """Those with contrast."""
    rows = np.arange(0, landmarks.own, max(-(-landmarks.own // _MAX_LANDMARKS), 1))
    pixels = here.pixels(landmarks.xy[rows])
    inside = here.holds(pixels)
    rows, pixels = rows[inside], pixels[inside]
    grey = here.windows(pixels, np.ones(len(rows)), np.eye(2), COMPARED_PX)
    contrast = grey.reshape(-1, COMPARED_PX**2).std(axis=1) > _MIN_CONTRAST
    return _Windows(landmarks.xyz[rows], landmarks.sigma[rows], grey).select(contrast)


def _correlation(windows: _Windows, here: _View, there: _View, there_from_here: Floats) -> Floats:
    """(n,) correlation of windows with those that the other image shows, NaN where it has none."""
    result = np.full(len(windows.xyz), np.nan)
    seen = in_view(there_from_here, windows.xyz, here.camera, there.camera)
    target = there.pixels(seen.xy)
    shift = _shift(windows.xyz[seen.rows], windows.sigma[seen.rows], there, there_from_here)
    inside = there.holds(target) & (shift < _MAX_SHIFT_PX)
    rows, size = seen.rows[inside], seen.size[inside] * there.scale[1] / here.scale[1]
    rotation = there_from_here[:2, :2]
    rotation = rotation / np.sqrt(max(abs(np.linalg.det(rotation)), 1e-12))
    area = there.windows(target[inside], size, rotation, _SEARCHED_PX)
    result[rows] = largest_correlation(windows.grey[rows], area)
    return result


def _shift(xyz: Floats, sigma: Floats, there: _View, motion: Floats) -> Floats:
    """(n,) pixels by which a landmark moves in the other image if its depth is wrong."""
    factor = 1.0 + np.array([[1.0], [-1.0]]) * np.minimum(2.0 * sigma, 0.9)
    moved = (factor[..., None] * xyz) @ motion[:3, :3].T + motion[:3, 3]
    focal = there.camera.fx, there.camera.fy
    ends = moved[..., :2] * focal / np.maximum(moved[..., 2:], 1e-9)
    return np.asarray(0.5 * np.linalg.norm((ends[0] - ends[1]) * there.scale, axis=1))
