"""Frames between keyframes, by the landmarks of a path that was adjusted as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import cv2
import numpy as np
import pytest

from vo.base.config import PatchConfig
from vo.base.geometry.rectification import RectifiedRig
from vo.base.types import Bytes, Floats
from vo.engine.frontend.patch_alignment import PatchAligner
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.keyframe import FrameId, Keyframe
from vo.engine.mapping.tracked_frame import TrackedFrame
from vo.engine.memory import final_frames
from vo.engine.memory.final_frames import AdjustedViews, FinalFrames
from vo.engine.memory.rematching import PathViews, references
from vo.engine.trajectory.builder import TrajectoryBuilder

_RIG = RectifiedRig(320, 240, 200.0, 200.0, 160.0, 120.0, 0.0, np.eye(4))
_STEP_PX, _DEPTH, _COUNT, _EVERY = 8.0, 4.0, 3, 4  # a keyframe in so many frames
_STEP = _STEP_PX * _DEPTH / _RIG.fx
_PATCHES = PatchAligner(PatchConfig(half_px=4))
_UNIT = 0.5


class _Path:
    """Keeps what is measured."""

    def __init__(self) -> None:
        self.measured: dict[int, Floats] = {}

    def measure(self, frames: Sequence[int], keyframe_from_cam: Floats) -> None:
        self.measured.update(zip(frames, keyframe_from_cam, strict=True))


class _Still:
    """A keyframe or a tracked frame."""

    def __init__(self, number: int, x: float) -> None:
        self.frame = FrameId(number, number, 0)
        self.world_from_cam = np.eye(4)
        self.world_from_cam[0, 3] = x


def _image(number: float) -> Bytes:
    """A wall along which the camera moves."""
    noise = np.random.default_rng(2).integers(0, 255, (240, 500)).astype(np.uint8)
    wall = cv2.GaussianBlur(noise, (0, 0), 2.0)
    wall = cv2.normalize(wall, np.empty_like(wall), 0, 255, cv2.NORM_MINMAX)
    shift = np.array([[1.0, 0.0, -_STEP_PX * number / _EVERY], [0.0, 1.0, 0.0]])
    return np.asarray(cv2.warpAffine(wall, shift, (320, 240), flags=cv2.INTER_CUBIC), np.uint8)


def _views() -> PathViews:
    u, v = (
        each.ravel() for each in np.meshgrid(np.arange(60.0, 300, 16), np.arange(30.0, 220, 16))
    )
    count, poses = len(u), np.tile(np.eye(4), (_COUNT, 1, 1))
    poses[:, 0, 3] = _STEP * np.arange(_COUNT)
    return PathViews(
        np.stack([_image(_EVERY * k) for k in range(_COUNT)]),
        [None] * _COUNT,
        poses,
        np.column_stack([(u - 160) / 200 * _DEPTH, (v - 120) / 200 * _DEPTH, u * 0 + _DEPTH]),
        np.tile([0.0, 0.0, 1.0], (count, 1)),
        np.repeat(np.arange(_COUNT), count),
        np.tile(np.arange(count), _COUNT),
        np.concatenate([np.stack([u - _STEP_PX * k, v], axis=1) for k in range(_COUNT)]),
        np.full(_COUNT * count, np.nan),
        np.full(_COUNT * count, 0.5),
    )


def _fitted(
    views: PathViews, segments: Sequence[int] = (0,) * _COUNT, gate: float = 0.6
) -> dict[int, Floats]:
    """What is measured of frames that were tracked 5 cm beside their places."""
    path = _Path()
    frames = FinalFrames(cast(TrajectoryBuilder, path), _PATCHES, gate)
    for number in range(_EVERY * _COUNT):
        if number % _EVERY:
            image, keyframe = _image(number), number // _EVERY
            frame = PreprocessedFrame(number, number, (image, None), (), (None, None))
            tracked = _Still(number, (_STEP * number / _EVERY + 0.02) / _UNIT)
            newest = _Still(_EVERY * keyframe, _STEP * keyframe / _UNIT)
            frames.see(frame, cast(TrackedFrame, tracked), cast(Keyframe, newest))
    keyframes = [FrameId(_EVERY * k, _EVERY * k, segments[k]) for k in range(_COUNT)]
    unit = np.full(_COUNT, _UNIT)
    frames.fit(AdjustedViews(views, _RIG, keyframes, unit, references(views)))
    return path.measured


def test_frames_are_where_they_see_the_landmarks() -> None:
    found = _fitted(_views())
    assert sorted(found) == [1, 2, 3, 4, 5, 6, 7, 8]  # none after the last keyframe
    for number, motion in found.items():
        since = (number - 1) % _EVERY + 1
        expected = np.eye(4)
        expected[0, 3] = since / _EVERY * _STEP / _UNIT
        np.testing.assert_allclose(motion, expected, atol=5e-4)  # 0.25 mm at 4 m


def test_frames_stay_between_segments_and_where_too_little_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    views = _views()
    assert sorted(_fitted(views, (0, 0, 1))) == [1, 2, 3, 4]
    few = np.flatnonzero(views.point % 3 == 0)  # 60 of 180
    assert not _fitted(views.select(few))
    assert not _fitted(views, gate=1e-6)  # nothing agrees
    monkeypatch.setattr(final_frames, "_MAX_BYTES", 2 * views.images[0].nbytes)
    assert sorted(_fitted(views)) == [1, 2, 3, 4]  # intervals are kept as a whole


def test_frames_that_are_tracked_anew_are_forgotten() -> None:
    path = _Path()
    frames = FinalFrames(cast(TrajectoryBuilder, path), _PATCHES, 0.6)
    for number in (1, 2):
        frame = PreprocessedFrame(number, number, (_image(number), None), (), (None, None))
        tracked = _Still(number, _STEP * number / _EVERY)
        frames.see(frame, cast(TrackedFrame, tracked), cast(Keyframe, _Still(0, 0.0)))
    frames.forget_from(2)
    views = _views()
    keyframes = [FrameId(_EVERY * k, 0, 0) for k in range(_COUNT)]
    frames.fit(AdjustedViews(views, _RIG, keyframes, np.ones(_COUNT), references(views)))
    assert sorted(path.measured) == [1, 4]
