"""Special cases of single formats."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import layouts
import numpy as np
import pytest

from vo.base.errors import CalibrationError
from vo.recordings.sources.registry import open_source

# KITTI


def test_kitti_colour_pair_has_its_own_calibration_and_truth(kitti: Path) -> None:
    (kitti / "image_0").rename(kitti / "image_2")
    (kitti / "image_1").rename(kitti / "image_3")
    fx, fy, cx, cy = layouts.INTRINSICS
    rows = [f"P{i}: {fx} 0 {cx} {fx * x} 0 {fy} {cy} 0 0 0 1 0" for i, x in
            enumerate([0.0, -0.5, 0.06, -0.44])]  # fmt: skip
    (kitti / "calib.txt").write_text("\n".join(rows))
    source = open_source(kitti)
    assert source.rig.cam1_from_cam0 is not None
    np.testing.assert_allclose(source.rig.cam1_from_cam0[:3, 3], [-0.5, 0, 0], atol=1e-12)
    assert source.ground_truth is not None
    # Camera 2 sits 6 cm to the left of camera 0, whose poses the file gives.
    np.testing.assert_allclose(source.ground_truth.positions[0], [-0.06, 0, 0], atol=1e-9)


def test_kitti_pairs_by_name_where_a_right_image_is_missing(kitti: Path) -> None:
    (kitti / "image_1/000002.png").unlink()
    source = open_source(kitti)
    frames = list(source.frames())
    assert [f.image1 is None for f in frames] == [False, False, True, False, False, False]
    assert frames[3].image1 is not None
    assert frames[3].image1[0, 0] == 103
    assert source.unpaired == 1


def test_kitti_reads_jpeg(kitti: Path) -> None:
    for path in kitti.glob("image_?/*.png"):
        layouts.write_image(path.with_suffix(".jpg"), cv2.imread(str(path)))
        path.unlink()
    assert len(list(open_source(kitti).frames())) == layouts.COUNT


def test_kitti_as_distributed_has_its_poses_in_a_folder_of_their_own(kitti: Path) -> None:
    root = kitti.parent / "dataset"
    (root / "sequences").mkdir(parents=True)
    (root / "poses").mkdir()
    (kitti / "poses.txt").rename(root / "poses" / "04.txt")
    kitti.rename(root / "sequences" / "04")
    truth = open_source(root / "sequences" / "04").ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth.world_from_cam, np.stack(layouts.truth()), atol=1e-9)


# 4Seasons


@pytest.fixture
def four_seasons(tmp_path: Path) -> Path:
    folder = tmp_path / "office" / "recording_2020-03-24_17-36-22"
    layouts.write_four_seasons(folder)
    return folder


def test_four_seasons_without_calibration_names_the_folder(four_seasons: Path) -> None:
    (four_seasons.parent / "calibration").rename(four_seasons.parent / "calib")
    with pytest.raises(CalibrationError, match="a folder `calibration` in .*recording_2020"):
        open_source(four_seasons)


def test_four_seasons_with_a_damaged_transform_names_the_file(four_seasons: Path) -> None:
    file = four_seasons.parent / "calibration" / "undistorted_calib_stereo.txt"
    for text in ("1 0 0 x\n", "1 0 0 -0.3\n0 1 0 0\n", "2 0 0 -0.3\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"):
        file.write_text(text)
        with pytest.raises(CalibrationError, match=r"undistorted_calib_stereo\.txt"):
            open_source(four_seasons)


def test_four_seasons_without_the_right_calibration_is_one_camera(four_seasons: Path) -> None:
    (four_seasons.parent / "calibration" / "undistorted_calib_1.txt").unlink()
    assert not open_source(four_seasons).rig.is_stereo


# EuRoC


@pytest.mark.parametrize("where", ["", "mav0"])
def test_euroc_opens_with_and_without_mav0_in_the_path(euroc: Path, where: str) -> None:
    source = open_source(euroc / where)
    assert (source.name, len(source)) == ("euroc", layouts.COUNT)


def test_euroc_opens_without_mav0_on_disk(euroc: Path, tmp_path: Path) -> None:
    (euroc / "mav0").rename(tmp_path / "flight")
    source = open_source(tmp_path / "flight")
    assert (source.name, source.format, len(source)) == ("flight", "euroc", layouts.COUNT)


@pytest.mark.parametrize("where", ["mav0", ".", ".."])
def test_euroc_with_a_kalibr_camchain(euroc: Path, where: str) -> None:
    camera = (
        f"camera_model: pinhole, resolution: [64, 48], intrinsics: {layouts.INTRINSICS}, "
        "distortion_model: radtan, distortion_coeffs: [-0.1, 0.0, 0.0, 0.0]"
    )
    rows = "[[1, 0, 0, -0.2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    chain = f"cam0: {{{camera}}}\ncam1: {{{camera}, T_cn_cnm1: {rows}}}\n"
    layouts.write_text(euroc / where / "camchain.yaml", chain)
    for sensor in euroc.rglob("sensor.yaml"):
        sensor.unlink()
    rig = open_source(euroc).rig
    assert rig.cam0.distortion == (-0.1, 0.0, 0.0, 0.0)
    assert rig.cam1_from_cam0 is not None
    assert rig.cam1_from_cam0[0, 3] == pytest.approx(-0.2)


def test_euroc_with_ground_truth_of_the_camera(euroc: Path) -> None:
    shutil.rmtree(euroc / "mav0/state_groundtruth_estimate0")
    layouts.write_text(euroc / "groundtruth.tum", layouts.tum_text(layouts.truth()))
    truth = open_source(euroc).ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth.world_from_cam, np.stack(layouts.truth()), atol=1e-9)


def test_euroc_reads_the_body_frame_from_sensor_yaml_with_a_given_calibration(
    euroc: Path, tmp_path: Path
) -> None:
    layouts.write_text(tmp_path / "mine.yaml", layouts.CALIBRATION)
    truth = open_source(euroc, calibration=tmp_path / "mine.yaml").ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth.world_from_cam, np.stack(layouts.truth()), atol=1e-9)


def test_euroc_does_not_confuse_poses_of_body_and_camera(
    euroc: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    layouts.write_text(tmp_path / "mine.yaml", layouts.CALIBRATION)
    (euroc / "mav0/cam0/sensor.yaml").unlink()
    assert open_source(euroc, calibration=tmp_path / "mine.yaml").ground_truth is None
    assert "no calibration contains cam0's pose on the body" in caplog.text


def test_euroc_reads_stamps_from_names_without_data_csv(euroc: Path) -> None:
    for table in euroc.glob("mav0/cam?/data.csv"):
        table.unlink()
    assert [f.stamp_ns for f in open_source(euroc).frames()] == layouts.STAMPS_NS


def test_euroc_reads_tables_with_windows_line_ends(euroc: Path) -> None:
    for table in euroc.glob("mav0/cam?/data.csv"):
        table.write_bytes(table.read_bytes().replace(b"\n", b"\r\n"))
    assert len(list(open_source(euroc).frames())) == layouts.COUNT


# Plain folders


def _plain(folder: Path, names: list[str]) -> Path:
    for i, name in enumerate(names):
        layouts.write_image(folder / name, layouts.image(i))
    layouts.write_text(folder / "calibration.yaml", layouts.CALIBRATION)
    return folder


def test_folder_sorts_numbers_by_value_and_assumes_10_fps(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = _plain(tmp_path / "walk", ["frame2.png", "frame10.png", "frame11.jpg"])
    frames = list(open_source(folder).frames())
    assert [int(f.image0[0, 0]) for f in frames[:2]] == [0, 1]
    assert [f.stamp_ns for f in frames] == [0, 100_000_000, 200_000_000]
    assert "10 frames per second are assumed" in caplog.text


@pytest.mark.parametrize(
    ("names", "stamps_ns"),
    [
        (["50735500923136", "50735602942464"], [50735500923136, 50735602942464]),
        (["1403636579763555584", "1403636579813555456"], None),
        (["1341841278842700", "1341841279510700"], [1341841278842700000, 1341841279510700000]),
        (["1341841278842", "1341841279510"], [1341841278842000000, 1341841279510000000]),
        (["1341841278", "1341841279"], [1341841278000000000, 1341841279000000000]),
        (["1341841278.8427", "1341841279.5107"], [1341841278842700000, 1341841279510700000]),
        (["cam0_1.25", "cam0_1.3"], [1250000000, 1300000000]),
        (["9.95", "10.05"], [9950000000, 10050000000]),
    ],
)
def test_folder_reads_stamps_from_names(
    tmp_path: Path, names: list[str], stamps_ns: list[int] | None
) -> None:
    folder = _plain(tmp_path / "walk", [f"{name}.png" for name in names])
    expected = [int(name) for name in names] if stamps_ns is None else stamps_ns
    assert [f.stamp_ns for f in open_source(folder).frames()] == expected


@pytest.mark.parametrize(
    "names", [["000000", "000001"], ["0000000001", "0000000002"], ["a", "b"], ["5.1", "5.1001"]]
)
def test_folder_does_not_read_counters_as_stamps(tmp_path: Path, names: list[str]) -> None:
    folder = _plain(tmp_path / "walk", [f"{name}.png" for name in names])
    assert [f.stamp_ns for f in open_source(folder).frames()] == [0, 100_000_000]


def test_folder_reads_nanoseconds_from_timestamps_txt(tmp_path: Path) -> None:
    folder = _plain(tmp_path / "walk", ["a.png", "b.png"])
    layouts.write_text(
        folder / "timestamps.txt", "# ns\n1403636579763555584\n1403636579813555456\n"
    )
    stamps = [f.stamp_ns for f in open_source(folder).frames()]
    assert stamps == [1403636579763555584, 1403636579813555456]


def test_folder_pairs_by_order_if_names_differ(folder: Path) -> None:
    for path in (folder / "right").iterdir():
        path.rename(path.with_name(path.name.replace("frame", "right")))
    frames = list(open_source(folder).frames())
    assert [int(f.image1[0, 0]) for f in frames if f.image1 is not None] == list(range(100, 106))


def test_folder_pairs_by_the_stamps_in_names(folder: Path) -> None:
    (folder / "times.txt").unlink()
    for i in range(layouts.COUNT):
        (folder / f"left/frame{i + 7}.png").rename(folder / f"left/{5 + i}.100000000.png")
        (folder / f"right/frame{i + 7}.png").rename(folder / f"right/{5 + i}.100900000.png")
    (folder / "right/7.100900000.png").unlink()
    frames = list(open_source(folder).frames())
    found = [None if f.image1 is None else int(f.image1[0, 0]) for f in frames]
    assert found == [100, 101, None, 103, 104, 105]


def test_folder_finds_the_calibration_beside_it(tmp_path: Path) -> None:
    folder = _plain(tmp_path / "walk", ["a.png", "b.png"])
    (folder / "calibration.yaml").rename(tmp_path / "calibration.yaml")
    assert open_source(folder).rig.cam0.fx == 50.0
