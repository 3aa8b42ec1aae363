"""TartanAir as its documentation describes it, written with its own size, names and axes."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from layouts import write_image, write_text

from vo.base.errors import CalibrationError, SourceError
from vo.base.types import Bytes, Floats32
from vo.recordings.sources.registry import detect_format, open_source

COUNT = 4
S = 0.5**0.5
POSES = f"""\
0 0 0 0 0 0 1
2 0 0 0 0 0 1
2 3 0 0 0 {S} {S}
2 3 -4 0 {S} 0 {S}
"""
"""At the start; 2 m ahead; 3 m to the right of that, turned right; 4 m up, looking up."""


def picture(index: int, height: int, right: bool = False) -> Bytes:
    pixels = np.random.default_rng(index).integers(0, 256, (height, 640), dtype=np.uint8)
    pixels[0, 0] = index + (100 if right else 0)
    return pixels


def metres(index: int, height: int) -> Floats32:
    """A slope, with the sky above."""
    depth = np.tile(np.linspace(0.5, 20.25, height, dtype=np.float32)[:, None], (1, 640)) + index
    depth[:3] = 10000.0
    return depth.astype(np.float32)


def write_version_1(folder: Path) -> Path:
    for i in range(COUNT):
        write_image(folder / f"image_left/{i:06d}_left.png", picture(i, 480))
        write_image(folder / f"image_right/{i:06d}_right.png", picture(i, 480, right=True))
        (folder / "depth_left").mkdir(exist_ok=True)
        np.save(folder / f"depth_left/{i:06d}_left_depth.npy", metres(i, 480))
    write_text(folder / "pose_left.txt", POSES)
    return folder


def write_version_2(folder: Path) -> Path:
    for i in range(COUNT):
        for side in "lr":
            file = folder / f"image_{side}cam_front/{i:06d}_{side}cam_front.png"
            write_image(file, picture(i, 640, right=side == "r"))
        packed = metres(i, 640).reshape(640, 640, 1).view(np.uint8)
        write_image(folder / f"depth_lcam_front/{i:06d}_lcam_front_depth.png", packed)
    write_text(folder / "pose_lcam_front.txt", POSES)
    return folder


WRITERS = {480: write_version_1, 640: write_version_2}


@pytest.mark.parametrize("height", WRITERS)
def test_pairs_cameras_and_times(tmp_path: Path, height: int) -> None:
    folder = WRITERS[height](tmp_path / "P001")
    source = open_source(folder)
    assert detect_format(folder) == source.format == "tartanair" and source.name == "P001"
    rig = source.rig
    for camera in rig.cameras:
        assert (camera.width, camera.height, camera.fx, camera.fy) == (640, height, 320, 320)
        assert (camera.cx, camera.cy, camera.is_distorted) == (320, height / 2, False)
    assert rig.cam1_from_cam0 is not None and not rig.has_depth
    assert rig.cam1_from_cam0[:3, 3].tolist() == [-0.25, 0, 0]
    frames = list(source.frames())
    assert [f.stamp_ns for f in frames] == [0, 100_000_000, 200_000_000, 300_000_000]
    for i, frame in enumerate(frames):
        assert np.array_equal(frame.image0, picture(i, height))
        assert frame.image1 is not None
        assert np.array_equal(frame.image1, picture(i, height, right=True))


@pytest.mark.parametrize("height", WRITERS)
def test_depth_without_right_images(tmp_path: Path, height: int) -> None:
    folder = WRITERS[height](tmp_path / "P001")
    shutil.rmtree(next(folder.glob("image_r*")))
    source = open_source(folder)
    assert source.rig.has_depth and not source.rig.is_stereo
    for i, frame in enumerate(source.frames()):
        assert frame.depth is not None and frame.depth.dtype == np.float32
        assert np.array_equal(frame.depth[3:], metres(i, height)[3:])
        assert not frame.depth[:3].any()  # the sky
    assert not open_source(folder, mode="mono").rig.has_depth


@pytest.mark.parametrize("height", WRITERS)
def test_poses_have_the_axes_of_an_image(tmp_path: Path, height: int) -> None:
    truth = open_source(WRITERS[height](tmp_path / "P001")).ground_truth
    assert truth is not None
    assert truth.stamps_ns.tolist() == [0, 100_000_000, 200_000_000, 300_000_000]
    start = truth.world_from_cam[0]
    poses = np.linalg.inv(start) @ truth.world_from_cam
    right_down_forward = [[0, 0, 0], [0, 0, 2], [3, 0, 2], [3, -4, 2]]
    np.testing.assert_allclose(poses[:, :3, 3], right_down_forward, atol=1e-12)
    np.testing.assert_allclose(poses[1, :3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(poses[2, :3, 2], [1, 0, 0], atol=1e-12)  # looks right
    np.testing.assert_allclose(poses[3, :3, 2], [0, -1, 0], atol=1e-12)  # looks up


def test_a_missing_image_leaves_a_gap_in_time(tmp_path: Path) -> None:
    folder = write_version_1(tmp_path / "P001")
    (folder / "image_left/000001_left.png").unlink()
    source = open_source(folder)
    assert source.stamps_ns.tolist() == [0, 200_000_000, 300_000_000]
    frame = list(source.frames())[1]
    assert frame.image1 is not None and frame.image1[0, 0] == 102
    assert source.ground_truth is not None and len(source.ground_truth.stamps_ns) == COUNT


def test_a_calibration_keeps_depth_in_metres(tmp_path: Path) -> None:
    folder = write_version_1(tmp_path / "P001")
    file = tmp_path / "camera.yaml"
    write_text(file, "cam0: {resolution: [640, 480], intrinsics: [321, 321, 320, 240]}\n")
    source = open_source(folder, calibration=file)
    frame = next(iter(source.frames()))
    assert source.rig.cam0.fx == 321 and frame.depth is not None
    assert frame.depth[479, 0] == np.float32(20.25)


@pytest.mark.parametrize("height", WRITERS)
@pytest.mark.parametrize("damage", ["short", "other", "empty", "text"])
def test_damaged_depth_is_named_once(
    tmp_path: Path, height: int, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    folder = WRITERS[height](tmp_path / "P001")
    shutil.rmtree(next(folder.glob("image_r*")))
    file = sorted(next(folder.glob("depth_*")).iterdir())[1]
    whole = file.read_bytes()
    if damage == "other" and height == 480:
        np.save(file, np.ones((480, 640), np.uint16))
    elif damage == "other":
        write_image(file, picture(1, 640))
    else:
        file.write_bytes({"short": whole[: len(whole) // 2], "empty": b"", "text": b"no"}[damage])
    frames = list(open_source(folder).frames())
    assert [frame.depth is not None for frame in frames] == [True, False, True, True]
    lines = [r.getMessage() for r in caplog.records if file.name in r.getMessage()]
    assert len(lines) == 1 and "is damaged, or has other values" in lines[0]


def test_missing_depth_is_that_of_its_frame(tmp_path: Path) -> None:
    folder = write_version_1(tmp_path / "P001")
    shutil.rmtree(folder / "image_right")
    (folder / "depth_left/000002_left_depth.npy").unlink()
    frames = list(open_source(folder).frames())
    assert [frame.depth is not None for frame in frames] == [True, True, False, True]


@pytest.mark.parametrize(("line", "said"), [("2 0 0 0 0 1", ":2"), ("2 0 0 0 0 x 1", ":2")])
def test_damaged_poses_are_one_line(
    tmp_path: Path, line: str, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write_version_1(tmp_path / "P001")
    lines = POSES.splitlines()
    write_text(folder / "pose_left.txt", "\n".join([lines[0], line, *lines[2:]]))
    assert open_source(folder).ground_truth is None
    found = [r.getMessage() for r in caplog.records if "pose_left.txt" in r.getMessage()]
    assert len(found) == 1 and f"pose_left.txt{said}" in found[0] and "\n" not in found[0]


def test_without_poses_there_is_no_truth(tmp_path: Path) -> None:
    folder = write_version_1(tmp_path / "P001")
    (folder / "pose_left.txt").unlink()
    assert open_source(folder).ground_truth is None


def test_other_names_are_refused(tmp_path: Path) -> None:
    folder = write_version_1(tmp_path / "P001")
    write_image(folder / "image_left/left.png", picture(0, 480))
    with pytest.raises(SourceError, match=r"left\.png.*begin with a number"):
        open_source(folder)


def test_resized_images_need_a_calibration(tmp_path: Path) -> None:
    folder = tmp_path / "P001"
    for i in range(COUNT):
        image = cv2.resize(picture(i, 480), (320, 240))
        write_image(folder / f"image_left/{i:06d}_left.png", image)
    with pytest.raises(CalibrationError, match="320x240.*640x480"):
        open_source(folder)
