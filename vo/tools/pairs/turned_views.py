"""A panorama of the views of a calibrated camera, by their rotations.

The focal length, which OpenCV's stitching has to guess, is known: views that overlap much, as
frames of a recording do, hardly show it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from vo.base.errors import InputError
from vo.base.types import Bytes, Camera, Floats
from vo.tools.pairs.image_pair import PairMatcher, PairOptions

_STITCHING: Any = cv2  # whose stubs lack much of it
_ALL_PAIRS, _WINDOW = 8, 3  # images of which all pairs are compared; neighbours of more
_WIDE_DEG = 60.0  # between views, from which on the horizon is found by them
_MAX_PIXELS = 2e8


class Link(NamedTuple):
    """Two views that overlap: second_from_first (3, 3), and whether the camera stayed in place."""

    inliers: int
    first: int
    second: int
    rotation: Floats
    is_turn: bool


class TurnedViews(NamedTuple):
    """Rotations (3, 3) of the views that fit together, from the camera to the panorama."""

    rotations: dict[int, Floats]
    camera_moved: bool


def find_turns(images: Sequence[Bytes], camera: Camera, options: PairOptions) -> TurnedViews:
    """How a camera was turned between images (H, W, 3) BGR without lens distortion.

    Raises:
        InputError: no two of them overlap.
    """
    matrix = camera.fx, camera.fy, camera.cx, camera.cy
    ideal = Camera(camera.width, camera.height, *matrix)
    matcher = PairMatcher(options._replace(cameras=(ideal, ideal)))
    features = [matcher.extract(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) for image in images]
    window = len(images) if len(images) <= _ALL_PAIRS else _WINDOW
    links = []
    for i in range(len(images)):
        for j in range(i + 1, min(i + window + 1, len(images))):
            pair = matcher.match(features[i], features[j])
            if pair.pose is not None:
                turn, is_turn = pair.pose.second_from_first[:3, :3], not pair.pose.has_translation
                links.append(Link(int(pair.inlier.sum()), i, j, turn, is_turn))
    if not links:
        raise InputError("no panorama: no two images overlap; give images that overlap by a third")
    rotations, used = _connected(sorted(links, key=lambda link: -link.inliers))
    moved = sum(not link.is_turn for link in used)
    return TurnedViews(_levelled(rotations), 2 * moved > len(used))


def _connected(links: list[Link]) -> tuple[dict[int, Floats], list[Link]]:
    """Rotations of images to the first one, by the links with most inliers, and these."""
    placed: dict[int, Floats] = {links[0].first: np.eye(3)}
    used: list[Link] = []
    while True:
        ends = ((link, link.first in placed, link.second in placed) for link in links)
        link = next((each for each, first, second in ends if first != second), None)
        if link is None:
            return placed, used
        used.append(link)
        if link.first in placed:
            placed[link.second] = placed[link.first] @ link.rotation.T
        else:
            placed[link.first] = placed[link.second] @ link.rotation


def _levelled(rotations: dict[int, Floats]) -> dict[int, Floats]:
    """Rotations to the view in the middle, or of a wide panorama to a level one."""
    views = np.array([each[:, 2] for each in rotations.values()])
    nearest = int(np.argmax(views @ views.sum(axis=0)))
    middle = list(rotations.values())[nearest]
    turned = {number: middle.T @ each for number, each in rotations.items()}
    if np.rad2deg(np.arccos(np.clip((views @ views.T).min(), -1.0, 1.0))) < _WIDE_DEG:
        return turned
    as_given = [each.astype(np.float32) for each in turned.values()]
    level = _STITCHING.detail.waveCorrect(as_given, _STITCHING.detail.WAVE_CORRECT_HORIZ)
    return dict(zip(turned, (np.asarray(each) for each in level), strict=True))


def compose(images: dict[int, Bytes], rotations: dict[int, Floats], camera: Camera) -> Bytes:
    """The picture (H, W, 3) BGR on a sphere of images without lens distortion.

    Raises:
        InputError: the picture would be too large.
    """
    warper = _STITCHING.PyRotationWarper("spherical", float(camera.fx))
    matrix = camera.matrix.astype(np.float32)
    corners, shown, masks = [], [], []
    for number, rotation in rotations.items():
        image, turn = images[number], rotation.astype(np.float32)
        given = (matrix, turn, cv2.INTER_LINEAR)
        corner, picture = warper.warp(image, *given, cv2.BORDER_REFLECT)
        full = np.full(image.shape[:2], 255, np.uint8)
        mask = warper.warp(full, matrix, turn, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT)[1]
        corners.append(corner)
        shown.append(picture)
        masks.append(mask)
    sizes = [(each.shape[1], each.shape[0]) for each in masks]
    area = _STITCHING.detail.resultRoi(corners=corners, sizes=sizes)
    if area[2] * area[3] > _MAX_PIXELS:
        raise InputError(
            f"the panorama would have {area[2]} x {area[3]} pixels; use smaller images"
        )
    gains = _STITCHING.detail.ExposureCompensator_createDefault(
        _STITCHING.detail.ExposureCompensator_GAIN
    )
    gains.feed(corners=corners, images=shown, masks=masks)
    seams = _STITCHING.detail.SeamFinder_createDefault(_STITCHING.detail.SeamFinder_VORONOI_SEAM)
    cut = seams.find(
        [each.astype(np.float32) for each in shown], corners, [m.copy() for m in masks]
    )
    blender = _STITCHING.detail_MultiBandBlender()
    blender.prepare(area)
    for n, picture in enumerate(shown):
        even = gains.apply(n, corners[n], picture, masks[n])
        blender.feed(cv2.UMat(even.astype(np.int16)), cut[n], corners[n])
    blended, _ = blender.blend(None, None)
    return np.asarray(np.clip(np.asarray(blended), 0, 255), dtype=np.uint8)
