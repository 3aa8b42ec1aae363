"""Recordings for each folder layout, and functions that read them back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from recordings import make_recording, make_shots

from data_synth.records import Recording
from data_synth.writers.registry import load_writer
from vo.base.geometry.transforms import make_transform
from vo.base.types import Camera, Frame, Rig
from vo.recordings.sources.registry import open_source

IDEAL = Camera(48, 32, 40.0, 41.0, 23.3, 15.7)
RATIONAL = replace(IDEAL, distortion_model="radtan", distortion=tuple(np.arange(8) * 1e-3 / 7))
BESIDE = make_transform(np.eye(3), np.array([-0.11, 0.0, 0.0]))
PAIR = Rig(IDEAL, IDEAL, BESIDE)
NO_DROPS = ((), ())
IN_FOLDERS = ("euroc", "kitti", "tum", "folder")


def suited(name: str) -> Recording:
    """The most complex recording that a layout can represent."""
    if name == "tum":
        return make_recording(stereo=False)
    recording = make_recording(drops=NO_DROPS) if name == "kitti" else make_recording()
    return replace(recording, rig=PAIR) if name == "kitti" else recording


def write_layout(name: str, path: Path, recording: Recording, codec: str = "png") -> Path:
    load_writer(name)(path, recording, make_shots(recording), codec)
    return path


def read_frames(path: Path) -> list[Frame]:
    return list(open_source(path).frames())


def check_images(frames: list[Frame], recording: Recording) -> None:
    """Check that frames have exactly the images of cam0 and their partners."""
    shots = [shot for shot in make_shots(recording) if shot.images[0] is not None]
    assert len(frames) == len(shots)
    for frame, shot in zip(frames, shots, strict=True):
        np.testing.assert_array_equal(frame.image0, shot.images[0])
        image1 = shot.images[1] if len(shot.images) == 2 else None
        assert (frame.image1 is None) == (image1 is None)
        if image1 is not None:
            np.testing.assert_array_equal(frame.image1, image1)


def read_table(path: Path) -> np.ndarray:
    return np.loadtxt(path, delimiter=",", comments="#")


def read_pixels(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
