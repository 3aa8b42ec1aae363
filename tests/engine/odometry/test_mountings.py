"""Stereo walks with cameras that are mounted in other ways than side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from recorded_walk import Recording, aligned, track

from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Bytes, Camera, Floats, Rig

COUNT = 15
_CODES = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180}


def _turned_image(image: Bytes | None, angle: int) -> Bytes | None:
    if image is None or angle == 0:
        return image
    return np.asarray(cv2.rotate(image, _CODES[angle]), dtype=np.uint8)


def _turned_camera(c: Camera, angle: int) -> tuple[Camera, Floats]:
    """The camera of images that are turned clockwise, and turned_from_camera (4, 4)."""
    if angle == 0:
        return c, np.eye(4)
    if angle == 90:
        turned = Camera(c.height, c.width, c.fy, c.fx, c.height - 1 - c.cy, c.cx)
        return turned, make_transform(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]), np.zeros(3))
    turned = replace(c, cx=c.width - 1 - c.cx, cy=c.height - 1 - c.cy)
    return turned, make_transform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


def _mounted(recording: Recording, left: int, right: int) -> Recording:
    """The walk with cameras that are turned by 0, 90 or 180 degrees each."""
    rig = recording.rig
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    assert not rig.cam0.is_distorted
    cam0, turned0 = _turned_camera(rig.cam0, left)
    cam1, turned1 = _turned_camera(rig.cam1, right)
    frames = [
        replace(f, images=(_turned_image(f.image0, left), _turned_image(f.image1, right)))
        for f in recording.frames[:COUNT]
    ]
    poses = recording.world_from_cam0 @ inverse(turned0)
    motion = turned1 @ rig.cam1_from_cam0 @ inverse(turned0)
    return Recording(Rig(cam0, cam1, motion), tuple(frames), poses)


def _exchanged(recording: Recording) -> Recording:
    """The walk with the right camera as cam0, as some people calibrate their pairs."""
    rig = recording.rig
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    frames = [replace(f, images=f.images[::-1]) for f in recording.frames[:COUNT]]
    poses = recording.world_from_cam0 @ inverse(rig.cam1_from_cam0)
    return Recording(Rig(rig.cam1, rig.cam0, inverse(rig.cam1_from_cam0)), tuple(frames), poses)


MOUNTINGS: dict[str, Callable[[Recording], Recording]] = {
    "one above the other": lambda r: _mounted(r, 90, 90),
    "right one upside down": lambda r: _mounted(r, 0, 180),
    "right one turned by 90 degrees": lambda r: _mounted(r, 0, 90),
    "both upside down": lambda r: _mounted(r, 180, 180),
    "the right one is cam0": _exchanged,
}


@pytest.fixture(scope="module")
def usual_ate(recording: Recording) -> float:
    return aligned(track(recording.rig, recording.frames[:COUNT]), recording, with_scale=False)[0]


@pytest.mark.parametrize("mounting", list(MOUNTINGS))
def test_pairs_track_as_well_however_they_are_mounted(
    recording: Recording, usual_ate: float, mounting: str
) -> None:
    mounted = MOUNTINGS[mounting](recording)
    run = track(mounted.rig, mounted.frames)
    assert run.numbers == list(range(COUNT))
    mounted_ate, _ = aligned(run, mounted, with_scale=False)
    _, fit = aligned(run, mounted, with_scale=True)
    assert mounted_ate < max(3.0 * usual_ate, 0.002)
    assert fit.scale == pytest.approx(1.0, abs=0.01)
    # Poses are those of the recorded cam0, not of the turned images.
    truth = mounted.world_from_cam0
    true_motion = inverse(truth[0]) @ truth[COUNT - 1]
    error = inverse(inverse(run.path[0]) @ run.path[-1]) @ true_motion
    assert np.linalg.norm(error[:3, 3]) < 0.02
