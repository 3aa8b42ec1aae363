"""Depth of a keyframe, as inverse depth, whose errors are alike at all distances.

A stereo pair is matched by semi-global matching (Hirschmüller, "Stereo processing by semiglobal
matching and mutual information", PAMI 2008), by OpenCV. A depth camera has measured it.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.geometry.rectification import RectifiedRig
from vo.base.types import Bools, Bytes, Floats32
from vo.tools.dense.keyframes import KeyframeImages

MAX_ERROR = 0.022  # relative standard deviation of the farthest depth of a single keyframe
SIGMA_PX = 0.25  # of a disparity where the surface has texture, on rendered rooms and streets
_BLOCK_PX = 5
_SIXTEENTHS = 16  # of a pixel, the unit of OpenCV's disparities
_RANGE = 0.2  # of the image's width, the largest disparity
_SPECKLE_PX, _SPECKLE_STEP_PX = 100, 2  # smaller regions of one depth are left out
_UNIQUENESS_PERCENT = 10
_HOLE_PX = 7  # least width of a hole beside which blocks are not trusted
_SENSOR_SIGMA = 0.0025  # of the inverse depth of a depth camera, 1/m; of a Kinect it is 0.0014


class DepthMap(NamedTuple):
    """What a keyframe sees.

    Attributes:
        inverse: (H, W) 1 / z in the camera, 0 where unknown.
        sigma: (H, W) standard deviation of it.
    """

    inverse: Floats32
    sigma: Floats32


def even_depth(inverse: Floats32, sigma: float) -> DepthMap:
    """Inverse depths (H, W) with one standard deviation."""
    return DepthMap(inverse, np.full(inverse.shape, sigma, np.float32))


class StereoDepth:
    """Depth of rectified pairs."""

    def __init__(self, rig: RectifiedRig) -> None:
        self._rig = rig
        self._reach = reach = int(np.ceil(_RANGE * rig.width / _SIXTEENTHS)) * _SIXTEENTHS
        area = _BLOCK_PX * _BLOCK_PX
        self._matcher = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=reach,
            blockSize=_BLOCK_PX,
            P1=8 * area,
            P2=32 * area,
            disp12MaxDiff=1,
            preFilterCap=63,
            uniquenessRatio=_UNIQUENESS_PERCENT,
            speckleWindowSize=_SPECKLE_PX,
            speckleRange=_SPECKLE_STEP_PX,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )

    def __call__(self, images: KeyframeImages) -> DepthMap:
        """Depth of a pair; unknown everywhere if it has no right image."""
        rig = self._rig
        scale = np.float32(1.0 / (rig.fx * rig.baseline_m))
        if images.right is None:
            return even_depth(np.zeros(images.left.shape, np.float32), SIGMA_PX * float(scale))
        found = self._matcher.compute(self._padded(images.left), self._padded(images.right))
        disparity = found[:, self._reach :].astype(np.float32) * np.float32(1.0 / _SIXTEENTHS)
        known = (disparity > 0) & (disparity <= np.arange(rig.width))
        if rig.disparity_offset_px or rig.disparity_curve_px:
            u = np.arange(rig.width, dtype=np.float64)[None] - disparity
            disparity = (disparity - rig.disparity_error(u)).astype(np.float32)
        known &= (disparity > 0) & ~_beside_holes(known)
        inverse = np.where(known, disparity * scale, np.float32(0))
        return even_depth(inverse.astype(np.float32), SIGMA_PX * float(scale))

    def _padded(self, image: Bytes) -> Bytes:
        """With columns on the left: OpenCV matches none that a largest disparity leads out of."""
        return np.asarray(cv2.copyMakeBorder(image, 0, 0, self._reach, 0, cv2.BORDER_REPLICATE))


def _beside_holes(known: Bools) -> Bools:
    """Where a block reaches into a hole (H, W): its depth is often that of what is in front."""
    square = np.ones((_HOLE_PX, _HOLE_PX), np.uint8)
    hole = cv2.morphologyEx((~known).astype(np.uint8), cv2.MORPH_OPEN, square)
    return np.asarray(cv2.dilate(hole, np.ones((_BLOCK_PX, _BLOCK_PX), np.uint8)), bool)


def measured_depth(images: KeyframeImages) -> DepthMap:
    """What a depth camera has measured.

    Source: Khoshelham and Elberink, "Accuracy and resolution of Kinect depth data for indoor
    mapping applications" (Sensors, 2012): errors that grow with the square of the depth.
    """
    depth = images.depth
    if depth is None:
        return even_depth(np.zeros(images.left.shape, np.float32), _SENSOR_SIGMA)
    known = np.isfinite(depth) & (depth > 0)
    inverse = np.zeros(depth.shape, np.float32)
    np.divide(np.float32(1), depth, out=inverse, where=known)
    return even_depth(inverse, _SENSOR_SIGMA)
