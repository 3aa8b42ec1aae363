"""A walk in a twelfth of the light, with the noise of a small sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from recorded_walk import Recording, Run, aligned, track

from vo.base.types import Bytes, Frame


def darkened(frame: Frame) -> Frame:
    rng = np.random.default_rng(frame.index)

    def dark(image: Bytes) -> Bytes:
        electrons = rng.poisson(image * 0.5) / 6.0  # 6 electrons for a grey level
        noisy = electrons + rng.normal(2.0, 1.0, image.shape)
        return np.asarray(np.clip(noisy.round(), 0, 255), np.uint8)

    return replace(frame, images=tuple(None if i is None else dark(i) for i in frame.images))


def test_dark_images_are_tracked_as_bright_ones_are(recording: Recording, stereo: Run) -> None:
    frames = [darkened(frame) for frame in recording.frames]
    assert max(float(np.mean(frame.image0)) for frame in frames) < 15.0
    run = track(recording.rig, frames)
    assert run.numbers == stereo.numbers
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 0.004 * recording.path_m


def test_one_camera_finds_its_path_in_the_dark(recording: Recording, mono: Run) -> None:
    run = track(recording.mono_rig, [darkened(frame) for frame in recording.mono()])
    assert len(run.numbers) > 0.8 * len(mono.numbers)
    ate, _ = aligned(run, recording, with_scale=True)
    assert ate < 0.01 * recording.path_m
