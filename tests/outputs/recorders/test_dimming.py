"""What masks hide is darker in recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import fake_run
import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rrd import read_rrd

from vo.base.records.snapshot import Snapshot
from vo.base.types import Bytes
from vo.outputs.recorders import entities
from vo.outputs.recorders.mcap_recorder import McapRecorder
from vo.outputs.recorders.reconstruction import dimmed
from vo.outputs.recorders.recorder import Recorder
from vo.outputs.recorders.rerun_recorder import RerunRecorder


def test_hidden_pixels_are_darker_and_others_as_they_were() -> None:
    image: Bytes = np.arange(200, dtype=np.uint8).reshape(10, 20)
    mask = np.full((10, 20), 255, np.uint8)
    mask[4:] = 0
    shown = dimmed(image, mask)
    np.testing.assert_array_equal(shown[:4], image[:4])
    assert (shown[4:] < 0.5 * image[4:]).all() and shown[4:].max() > 50
    assert dimmed(image, None) is image


def _masked(frame: int) -> Snapshot:
    """A grey pair whose left image is hidden on the left, the right one on the right."""
    snapshot = fake_run.snapshot(frame)
    grey = np.full_like(snapshot.view.image0, 200)
    left, right = np.full_like(grey, 255), np.full_like(grey, 255)
    half = grey.shape[1] // 2
    left[:, :half] = right[:, half:] = 0
    view = replace(snapshot.view, image0=grey, image1=grey, masks=(left, right))
    return replace(snapshot, view=view)


def _record(recorder: Recorder) -> None:
    recorder.begin("masked", fake_run.RIG, None)
    recorder.record(fake_run.estimate(0), lambda: _masked(0))
    recorder.finish(fake_run.trajectory(), fake_run.trajectory())


def _halves(data: Any) -> tuple[float, float]:
    """Mean grey level of the left and the right half of an image file."""
    image = cv2.imdecode(np.frombuffer(bytes(data), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    half = image.shape[1] // 2
    return float(image[:, :half].mean()), float(image[:, half:].mean())


def test_both_images_of_a_rerun_recording_show_it(tmp_path: Path) -> None:
    _record(RerunRecorder(tmp_path / "run.rrd", images="full"))
    blobs = read_rrd(tmp_path / "run.rrd", "blob")
    ((_, (left,)),), ((_, (right,)),) = blobs[entities.LEFT_IMAGE], blobs[entities.RIGHT_IMAGE]
    np.testing.assert_allclose(_halves(left), (70, 200), atol=3)
    np.testing.assert_allclose(_halves(right), (200, 70), atol=3)


def test_the_image_of_an_mcap_recording_shows_it(tmp_path: Path) -> None:
    _record(McapRecorder(tmp_path / "run.mcap"))
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        ((*_, image),) = reader.iter_decoded_messages("/image")
    np.testing.assert_allclose(_halves(image.data), (70, 200), atol=3)
