"""Masks of the whole run: what they hide is used by neither camera, and is no fault."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from own_body import first_row, with_body
from recorded_walk import CONFIG, Recording, Run, aligned, track

from vo.base.config import Config, MasksConfig
from vo.base.types import Bytes, Frame
from vo.engine.geometry.image_masks import used_at

_TEXT_ROWS = 24


def _with_text(frame: Frame) -> Frame:
    """Burnt-in text with the number of the frame."""
    images: list[Bytes | None] = []
    for image in frame.images:
        assert image is not None
        written = image.copy()
        written[:_TEXT_ROWS] //= 3
        text = f"{frame.index:05d} CAM 1 REC N 48.9843 E 8.3921"
        cv2.putText(written, text, (4, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 255, 1, cv2.LINE_AA)
        images.append(written)
    return replace(frame, images=tuple(images))


def _masked(recording: Recording) -> Config:
    width, height = recording.rig.cam0.width, recording.rig.cam0.height
    top = first_row(height)
    areas = (f"both:0,{top},{width},{height - top}", f"both:0,0,{width},{_TEXT_ROWS}")
    return CONFIG.model_copy(update={"masks": MasksConfig(ignore=areas)})


def _covered(frames: list[Frame]) -> list[Frame]:
    return [_with_text(with_body(frame)) for frame in frames]


def _assert_nothing_hidden_is_used(run: Run) -> None:
    """No patch round a feature or an observation of a landmark reaches body or text."""
    left, right = run.snapshots[0].view.masks
    assert left is not None
    rows = _TEXT_ROWS + CONFIG.patches.half_px, first_row(len(left)) - 1 - CONFIG.patches.half_px
    for snapshot in run.snapshots:
        view, landmarks = snapshot.view, snapshot.landmarks
        assert view.masks[0] is left and view.masks[1] is right  # not made for every frame
        sightings = () if landmarks is None else landmarks.sightings
        for xy in (view.xy, *(each.xy for each in sightings)):
            assert len(xy) == 0 or rows[0] <= xy[:, 1].min() <= xy[:, 1].max() <= rows[1]


def test_body_and_text_change_nothing_in_stereo(recording: Recording, stereo: Run) -> None:
    config = _masked(recording)
    run = track(recording.rig, _covered([*recording.frames]), config, takes_snapshots=True)
    _assert_nothing_hidden_is_used(run)
    assert run.odometry.hidden[0] == run.odometry.hidden[1] > 0.3
    assert not any(estimate.faults for estimate in run.estimates)
    assert run.numbers == stereo.numbers
    clean, _ = aligned(stereo, recording, with_scale=False)
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 1.5 * clean + 0.001


def test_body_and_text_change_nothing_in_mono(recording: Recording, mono: Run) -> None:
    frames = [replace(f, images=f.images[:1]) for f in _covered([*recording.frames])]
    run = track(recording.mono_rig, frames, _masked(recording), takes_snapshots=True)
    _assert_nothing_hidden_is_used(run)
    assert not any(estimate.faults for estimate in run.estimates)
    assert len(run.numbers) >= len(mono.numbers) - 2
    ate, _ = aligned(run, recording, with_scale=True)
    assert ate < 0.01 * recording.path_m


def test_disparities_are_not_measured_in_what_is_hidden_on_the_right(
    recording: Recording, stereo: Run
) -> None:
    width, height = recording.rig.cam0.width, recording.rig.cam0.height
    area = f"right:{width // 3},0,{width // 3},{height}"
    config = CONFIG.model_copy(update={"masks": MasksConfig(ignore=(area,))})
    run = track(recording.rig, recording.frames[:12], config, takes_snapshots=True)
    mask = run.snapshots[0].view.masks[1]
    assert mask is not None and run.snapshots[0].view.masks[0] is None

    def measured(of: Run) -> list[bool]:
        """Whether each disparity was measured at a pixel that the mask does not hide."""
        shown: list[bool] = []
        for snapshot in of.snapshots[:12]:
            view = snapshot.view
            assert view.right_u is not None
            at = np.column_stack([view.right_u, view.xy[:, 1]])[~np.isnan(view.right_u)]
            shown += used_at(mask, at).tolist()
        return shown

    assert np.mean(measured(stereo)) < 0.8
    assert all(measured(run)) and len(measured(run)) > 500
    assert run.numbers == stereo.numbers[: len(run.numbers)]


def test_without_masks_no_image_is_changed(stereo: Run) -> None:
    assert {snapshot.view.masks for snapshot in stereo.snapshots} == {(None, None)}
    assert stereo.odometry.hidden == (0.0, 0.0)
