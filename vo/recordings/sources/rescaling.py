"""Images of a focal length that changes, as a camera with a constant one would have seen them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from vo.base.records.focal_length import FocalLength
from vo.base.types import Camera, Frame, Rig
from vo.recordings.sources.sequence import ImageSequence


def at_constant_focal_length(stream: ImageSequence, focal: Sequence[FocalLength]) -> ImageSequence:
    """The recording with images enlarged about the principal point to the longest focal length.

    Images are enlarged rather than reduced, so that none has an empty border.
    """
    longest = max(each.focal_px for each in focal)
    factor = longest / stream.rig.cam0.fx
    stamps_ns = [each.stamp_ns for each in focal]
    logs = np.log([longest / each.focal_px for each in focal])
    rig = stream.rig
    cam1 = None if rig.cam1 is None else _scaled(rig.cam1, factor)
    scaled = replace(rig, cam0=_scaled(rig.cam0, factor), cam1=cam1)

    def enlarged(frame: Frame) -> Frame:
        scale = float(np.exp(np.interp(frame.stamp_ns, stamps_ns, logs)))
        return _enlarged(frame, scaled, scale)

    found = copy.copy(stream)
    found.rig, found.rescale = scaled, enlarged
    return found


def _scaled(camera: Camera, factor: float) -> Camera:
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)


def _enlarged(frame: Frame, rig: Rig, scale: float) -> Frame:
    def warped(image: np.ndarray, camera: Camera, flags: int) -> np.ndarray:
        centre = np.array([camera.cx, camera.cy])
        image_from_scaled = np.column_stack([np.eye(2) / scale, centre * (1.0 - 1.0 / scale)])
        enlarged: np.ndarray = cv2.warpAffine(
            image,
            image_from_scaled,
            (camera.width, camera.height),
            flags=flags | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return enlarged

    cameras = zip(frame.images, (rig.cam0, rig.cam1 or rig.cam0), strict=False)
    images = tuple(None if i is None else warped(i, c, cv2.INTER_LINEAR) for i, c in cameras)
    depth = None if frame.depth is None else warped(frame.depth, rig.cam0, cv2.INTER_NEAREST)
    return replace(frame, images=images, depth=depth, path=None)
