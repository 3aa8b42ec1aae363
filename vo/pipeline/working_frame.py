"""A frame made ready: rectified, its features found and undistorted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.features.orb import OrbDetector
from vo.geometry.rectification import WorkingRig
from vo.types import Bools, Bytes, Floats, Frame, Keypoints


@dataclass(frozen=True, eq=False)
class WorkingFrame:
    """What tracking works on.

    Attributes:
        index: number of the frame in its source.
        stamp_ns: its time.
        image0: (H, W) uint8 working image of the left camera.
        image1: the same of the right camera, or None.
        keypoints: features of image0, all inside the ideal camera's field of view.
        ideal_xy: (N, 2) float64 their ideal pinhole pixels.
    """

    index: int
    stamp_ns: int
    image0: Bytes
    image1: Bytes | None
    keypoints: Keypoints
    ideal_xy: Floats


def prepare(frame: Frame, rig: WorkingRig, detector: OrbDetector) -> WorkingFrame:
    """Rectify a frame and find its features."""
    image0 = rig.rectify(frame.image0, 0)
    has_right = rig.is_stereo and frame.image1 is not None
    image1 = rig.rectify(frame.image1, 1) if has_right and frame.image1 is not None else None
    keypoints = detector.detect(image0)
    ideal = rig.ideal_from_image(keypoints.xy.astype(np.float64))
    inside = np.asarray(np.isfinite(ideal).all(axis=1))
    if not inside.all():
        keypoints, ideal = select(keypoints, inside), ideal[inside]
    return WorkingFrame(frame.index, frame.stamp_ns, image0, image1, keypoints, ideal)


def select(keypoints: Keypoints, rows: Bools) -> Keypoints:
    """Some rows of keypoints."""
    return Keypoints(
        keypoints.xy[rows],
        keypoints.octave[rows],
        keypoints.angle[rows],
        keypoints.response[rows],
        keypoints.descriptor[rows],
    )
