"""Real recordings, if available."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vo.base.errors import CalibrationError
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source


def test_kitti_stereo(shared_data: Path) -> None:
    source = open_source(shared_data / "kitti06_stereo_000-050")
    assert (source.format, len(source)) == ("kitti", 51)
    assert source.rig.cam1_from_cam0 is not None
    assert source.rig.cam1_from_cam0[0, 3] == pytest.approx(-379.8145 / 707.0912, abs=1e-9)
    frames = list(source.frames(0, 3))
    assert [f.stamp_ns for f in frames] == [0, 104498900, 207793500]
    assert all(f.image1 is not None and f.image1.shape == (370, 1226) for f in frames)
    assert source.ground_truth is not None
    length = np.linalg.norm(np.diff(source.ground_truth.positions, axis=0), axis=1).sum()
    assert length == pytest.approx(59.9, abs=0.1)


def test_kitti_without_right_images(shared_data: Path) -> None:
    source = open_source(shared_data / "kitti07_mono_000-099")
    assert len(source) == 100
    assert not source.rig.is_stereo
    assert source.ground_truth is not None


def test_unrectified_stereo_with_dropped_frames(
    shared_data: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = open_source(shared_data / "kitti_raw_stereo_000-099")
    assert (source.format, len(source)) == ("euroc", 99)
    assert source.rig.cam0.distortion_model == "radtan"
    assert len(source.rig.cam0.distortion) == 5
    frames = list(source.frames(15, 30))
    # Number 23 of the left camera is missing, so that the frame without a right one stays 22.
    assert [f.index for f in frames if f.image1 is None] == [22]
    assert frames[0].stamp_ns == 50737049933568
    assert source.unpaired == 1
    assert "1 of 99 right images have no left image" in caplog.text
    assert source.ground_truth is not None
    assert len(source.ground_truth) == 98


def test_rendered_stereo_truth_of_body_and_camera_agree(shared_data: Path) -> None:
    folder = shared_data / "rendered_hall_stereo"
    source = open_source(folder)
    assert (source.format, len(source), source.rig.is_stereo) == ("euroc", 200, True)
    assert source.rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(source.rig.cam1_from_cam0[:3, 3], [-0.12, 0, 0], atol=1e-6)
    truth, of_camera = source.ground_truth, read_tum(folder / "groundtruth.tum")
    assert truth is not None
    _, ours, theirs = np.intersect1d(truth.stamps_ns, of_camera.stamps_ns, return_indices=True)
    assert len(ours) > 190
    np.testing.assert_allclose(
        truth.world_from_cam[ours], of_camera.world_from_cam[theirs], atol=1e-6
    )


def test_tum_needs_a_calibration(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "tum_fr3_cabinet_58_lowtexture"
    with pytest.raises(CalibrationError, match="`calibration=FILE`"):
        open_source(folder)
    calibration = tmp_path / "fr3.yaml"
    calibration.write_text(
        "cam0: {resolution: [640, 480], intrinsics: [535.4, 539.2, 320.1, 247.6]}"
    )
    source = open_source(folder, calibration=calibration)
    frames = list(source.frames(0, 2))
    assert (source.format, len(source)) == ("tum", 58)
    assert [f.stamp_ns for f in frames] == [1341841278842700000, 1341841279510700000]
    assert frames[0].image0.shape == (480, 640)
    assert source.ground_truth is not None
