"""Contract of all formats, tested with the same six frames in each layout."""

from __future__ import annotations

from pathlib import Path

import layouts
import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.registry import FORMATS, detect_format, open_source

STEREO = {"kitti", "kitti_raw", "euroc", "4seasons", "folder", "glob", "mcap", "rosbag1", "rosbag2"}
WITHOUT_TRUTH = {"glob", "video"}


def test_all_registered_formats_are_tested() -> None:
    elsewhere = {"nuscenes", "tartanair"}  # test_rig_datasets.py and test_tartanair.py
    assert set(layouts.WRITERS) | elsewhere == set(FORMATS)


def test_format_and_name(kind: str, recording: Path) -> None:
    source = open_source(recording)
    assert detect_format(recording) == source.format == source.name == kind


def test_all_frames_in_order_with_exact_stamps(kind: str, recording: Path) -> None:
    source = open_source(recording)
    frames = list(source.frames())
    assert len(source) == len(frames) == layouts.COUNT
    assert [f.index for f in frames] == list(range(layouts.COUNT))
    assert [f.stamp_ns for f in frames] == source.stamps_ns.tolist() == layouts.stamps(kind)
    for i, frame in enumerate(frames):
        assert frame.image0.dtype == np.uint8
        assert np.array_equal(frame.image0, layouts.image(i))
    assert source.skipped == []


def test_pairs_left_and_right(kind: str, recording: Path) -> None:
    source = open_source(recording)
    assert source.rig.is_stereo == (kind in STEREO)
    for i, frame in enumerate(source.frames()):
        if source.rig.is_stereo:
            assert frame.image1 is not None
            assert np.array_equal(frame.image1, layouts.image(i, right=True))
        else:
            assert frame.image1 is None
    assert source.unpaired == 0


def test_reads_the_calibration(recording: Path) -> None:
    rig = open_source(recording).rig
    cam0 = rig.cam0
    assert (cam0.width, cam0.height) == (layouts.WIDTH, layouts.HEIGHT)
    assert [cam0.fx, cam0.fy, cam0.cx, cam0.cy] == layouts.INTRINSICS
    assert not cam0.is_distorted
    if rig.is_stereo:
        assert rig.cam1_from_cam0 is not None
        expected = np.eye(4)
        expected[0, 3] = -layouts.BASELINE_M
        np.testing.assert_allclose(rig.cam1_from_cam0, expected, atol=1e-9)


def test_ground_truth_of_the_left_camera(kind: str, recording: Path) -> None:
    truth = open_source(recording).ground_truth
    if kind in WITHOUT_TRUTH:
        assert truth is None
        return
    assert truth is not None
    assert truth.stamps_ns.tolist() == layouts.STAMPS_NS
    np.testing.assert_allclose(truth.world_from_cam, np.stack(layouts.truth()), atol=1e-9)


def test_slices(recording: Path) -> None:
    source = open_source(recording)
    assert [f.index for f in source.frames(1, 6, 2)] == [1, 3, 5]
    assert [f.index for f in source.frames(start=4)] == [4, 5]
    assert [f.index for f in source.frames(end=2)] == [0, 1]
    assert [f.index for f in source.frames(4, 1000)] == [4, 5]
    assert len(source) == layouts.COUNT


@pytest.mark.parametrize(
    ("start", "end", "stride", "message"),
    [
        (6, None, 1, "has only 6 frames"),
        (3, 3, 1, "end is 3, not after start 3"),
        (-1, None, 1, "frame numbers begin at 0"),
        (0, -2, 1, "frame numbers begin at 0"),
        (0, None, 0, "stride is 0"),
    ],
)
def test_error_for_slices_without_frames(
    recording: Path, start: int, end: int | None, stride: int, message: str
) -> None:
    with pytest.raises(SourceError, match=message):
        open_source(recording).frames(start, end, stride)


def test_mono_leaves_the_right_camera_out(recording: Path) -> None:
    source = open_source(recording, mode="mono")
    assert source.rig.cam1 is None
    assert source.rig.cam1_from_cam0 is None
    assert all(frame.image1 is None for frame in source.frames())
    assert source.unpaired == 0


def test_given_calibration_overrides_that_of_the_recording(recording: Path, tmp_path: Path) -> None:
    text = layouts.CALIBRATION.replace("intrinsics: [50.0", "intrinsics: [77.0")
    layouts.write_text(tmp_path / "mine.yaml", text)
    assert open_source(recording, calibration=tmp_path / "mine.yaml").rig.cam0.fx == 77.0


def test_can_be_opened_and_read_twice(recording: Path) -> None:
    source = open_source(recording)
    first = [frame.stamp_ns for frame in source.frames()]
    assert [frame.stamp_ns for frame in source.frames()] == first


def test_an_unreadable_image_is_skipped_with_one_warning(
    folder_recording: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = open_source(folder_recording)
    victim = next(p for p in folder_recording.rglob("*.png") if ImageFile(p).read()[0, 0] == 3)
    victim.write_bytes(victim.read_bytes()[:-20])
    caplog.clear()
    assert [f.index for f in source.frames()] == [0, 1, 2, 4, 5]
    assert [(s.index, s.stamp_ns) for s in source.skipped] == [(3, layouts.STAMPS_NS[3])]
    assert "cut off" in source.skipped[0].reason
    assert len(caplog.records) == 1
    assert str(victim) in caplog.text
