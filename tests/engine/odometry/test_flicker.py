"""Images with the bands of a flickering light, in which wrong poses have many inliers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from recorded_walk import Recording, Run, track

from vo.base.config import Config
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.similarity import umeyama
from vo.base.types import Bytes, Frame
from vo.recordings.sources.registry import open_source


def banded(image: Bytes, phase: float) -> Bytes:
    rows = np.arange(len(image))[:, None] / len(image)
    grey = image * (1.0 + 0.6 * np.sin(phase + 2.0 * np.pi * 2.3 * rows))
    return np.asarray(grey.clip(0, 255), dtype=np.uint8)


def flickering(frame: Frame) -> Frame:
    phase = float(np.random.default_rng((3, frame.index)).uniform(0.0, 2.0 * np.pi))
    pair = tuple(None if image is None else banded(image, phase) for image in frame.images)
    return replace(frame, images=pair)


def test_no_step_is_larger_than_the_true_ones_by_much(shared_data: Path) -> None:
    """One step was 0.16 m instead of 0.05 m."""
    recording = open_source(shared_data / "rendered_hall_stereo")
    frames = [flickering(frame) for frame in recording.frames(130, 160)]
    run = track(recording.rig, frames, Config(threads=1))
    truth = recording.ground_truth
    assert truth is not None
    path = run.odometry.trajectory.trajectory()
    assert len(path) == 30
    true_xyz = np.stack(
        [np.interp(path.stamps_ns, truth.stamps_ns, axis) for axis in truth.positions.T], axis=1
    )
    fit = umeyama(path.positions, true_xyz, with_scale=False)
    errors = np.linalg.norm(fit.transform_points(path.positions) - true_xyz, axis=1)
    assert float(np.sqrt(np.mean(errors**2))) < 0.01
    assert float(np.linalg.norm(np.diff(path.positions, axis=0), axis=1).max()) < 0.06


def woven(frame: Frame, later: Frame) -> Frame:
    """Odd rows of the next frame."""

    def image(now: Bytes | None, after: Bytes | None) -> Bytes | None:
        if now is None or after is None:
            return now
        result = now.copy()
        result[1::2] = after[1::2]
        return result

    return replace(frame, images=tuple(map(image, frame.images, later.images)))


def interlaced(run: Run) -> list[Fault]:
    faults = [fault for e in run.estimates for fault in e.faults]
    return [fault for fault in faults if fault.kind is FaultKind.INTERLACED_IMAGES]


def test_interlaced_frames_are_reported_and_clean_ones_are_not(recording: Recording) -> None:
    clean = recording.frames[:9]
    frames = [woven(*pair) for pair in zip(clean[:-1], clean[1:], strict=True)]
    faults = interlaced(track(recording.rig, frames))
    assert len(faults) == 4  # from the second image examined on
    assert not any(fault.is_handled for fault in faults)
    assert not interlaced(track(recording.rig, clean))
