"""Large things that move: a lorry that is followed closely, somebody who walks past."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from recorded_walk import track

from vo.base.config import Config
from vo.base.types import Bytes, Frame, Rig, State
from vo.recordings.sources.registry import open_source

BASELINE_M = 0.537  # of KITTI
WIDTH_M, HEIGHT_M, PX_PER_M = 2.5, 2.7, 200


def rear() -> Bytes:
    """Dirty doors, lettering and lamps."""
    rng = np.random.default_rng(8)
    size = round(WIDTH_M * PX_PER_M), round(HEIGHT_M * PX_PER_M)
    dirt = np.full(size[::-1], 120.0)
    for cell, contrast in ((4, 8), (20, 20)):
        coarse = rng.normal(size=(size[1] // cell + 2, size[0] // cell + 2))
        dirt += contrast * cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    image = np.asarray(dirt.clip(0, 255), np.uint8)
    for number in range(70):
        x, y = int(rng.integers(0, 480)), int(rng.integers(0, 520))
        width, height, grey = (int(rng.integers(*ends)) for ends in ((8, 80), (6, 50), (10, 245)))
        corner = x + width, y + height
        cv2.rectangle(image, (x, y), corner, grey, -1 if number % 2 else 3)
        if number % 3 == 0:
            font = cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(image, f"TRANS{number}", (x, y), font, 0.7, 255 - grey, 2)
    return image


def behind_lorry(frame: Frame, rig: Rig, texture: Bytes, mean_m: float) -> Frame:
    distance_m = mean_m * (1.0 + 0.08 * np.sin(frame.index / 7.0))
    images = []
    for camera, image in enumerate(frame.images):
        assert image is not None
        cam = rig.cam0
        left_m = 0.3 * np.sin(frame.index / 11.0) - 0.2 - WIDTH_M / 2 - BASELINE_M * camera
        scale = cam.fx / distance_m
        corner = cam.cx + scale * left_m, cam.cy + scale * (1.5 - HEIGHT_M)
        matrix = np.array([[scale, 0.0, corner[0]], [0.0, scale, corner[1]]]) / (
            [[PX_PER_M, 1.0, 1.0], [1.0, PX_PER_M, 1.0]]
        )
        size = image.shape[::-1]
        share = cv2.warpAffine(np.full(texture.shape, 255, np.uint8), matrix, size) / 255.0
        lorry = cv2.warpAffine(cv2.GaussianBlur(texture, (0, 0), 0.7), matrix, size)
        images.append(np.asarray(np.rint(image * (1.0 - share) + lorry * share), np.uint8))
    return replace(frame, images=tuple(images))


@pytest.mark.parametrize("mean_m", [7.8, 5.0])
def test_the_road_decides_the_first_step(shared_data: Path, mean_m: float) -> None:
    """The path stood still with the lorry, which has fewer, but better matches."""
    recording = open_source(shared_data / "kitti06_stereo_000-050")
    texture = rear()
    frames = [
        behind_lorry(frame, recording.rig, texture, mean_m) for frame in recording.frames(0, 8)
    ]
    run = track(recording.rig, frames, Config(threads=1))
    steps = np.linalg.norm(np.diff(run.path[:, :3, 3], axis=0), axis=1)
    assert len(steps) == 7
    truth = recording.ground_truth
    assert truth is not None
    true = np.linalg.norm(np.diff(truth.positions[:8], axis=0), axis=1)
    np.testing.assert_allclose(steps, true, rtol=0.05)


def test_somebody_who_walks_past_a_camera_at_rest_does_not_take_it_along(shared_data: Path) -> None:
    """Over 52 % of the image: the path was 3.7 m long."""
    recording = open_source(shared_data / "rendered_hall_stereo")
    (standing,) = recording.frames(0, 1)
    rng = np.random.default_rng(2)
    coat = cv2.resize(rng.normal(110.0, 35.0, (50, 42)), (330, 400), interpolation=cv2.INTER_CUBIC)
    frames = []
    for number in range(70):
        images = []
        left_px = -400 + round(1110 * min(max(number - 10, 0) / 50, 1.0))
        for camera, image in enumerate(standing.images):
            assert image is not None
            seen = image.astype(float)
            first = left_px - 30 * camera
            begin, end = np.clip([first, first + 330], 0, seen.shape[1])
            seen[:, begin:end] = coat[:, begin - first : end - first]
            noise = rng.normal(0.0, 1.5, seen.shape)
            images.append(np.asarray((seen + noise).clip(0, 255), np.uint8))
        stamp_ns = standing.stamp_ns + number * 50_000_000
        frames.append(Frame(number, stamp_ns, tuple(images)))
    run = track(recording.rig, frames, Config(threads=1))
    assert all(each.state is State.TRACKING for each in run.estimates)
    away_m = np.linalg.norm(run.path[:, :3, 3], axis=1)
    assert away_m.max() < 0.01
