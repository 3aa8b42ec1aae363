"""Videos of phones: tables beside them, Stray Scanner, and what cameras say of their lens."""

from __future__ import annotations

import struct
from pathlib import Path

import av
import cv2
import layouts
import numpy as np
import pytest
import video_files
from typer.testing import CliRunner

from vo.base.errors import SourceError
from vo.cli.app import app
from vo.recordings.sources.camera_hint import camera_hint
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.registry import open_source
from vo.runs.scaling.positions import read_positions

NS = video_files.expected_ns()


def imu_table(path: Path, first_s: float, accel: str = "0.1,0.2,9.8") -> None:
    rows = [f"{first_s + 0.01 * n:.3f},0.1,0.2,{0.001 * n},{accel}\n" for n in range(200)]
    path.write_text("timestamp [s],gx,gy,gz,ax,ay,az\n" + "".join(rows))


def test_table_of_a_sensor_beside_a_video(tmp_path: Path) -> None:
    clip = video_files.write(tmp_path / "clip.mp4", "libx264")
    imu_table(tmp_path / "clip_imu.csv", 500.0)
    (tmp_path / "clip_timestamps.txt").write_text("".join(f"{500e9 + ns:.0f}\n" for ns in NS))
    source = open_source(clip)
    assert source.stamps_ns.tolist() == [500_000_000_000 + ns for ns in NS]
    samples = source.imus[0].read()
    assert (len(samples), int(samples.stamps_ns[0])) == (200, 500_000_000_000)
    assert samples.accel[0].tolist() == [0.1, 0.2, 9.8]
    assert source.imus[0].cam0_from_imu is None


def test_clocks_without_stamps_are_taken_to_begin_together(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    clip = video_files.write(tmp_path / "clip.mp4", "libx264")
    imu_table(tmp_path / "imu.csv", 500.0)
    samples = open_source(clip).imus[0].read()
    assert int(samples.stamps_ns[0]) == NS[0]
    assert "different clocks" in caplog.text
    assert "clip_timestamps.txt" in caplog.text


def stray(folder: Path, poses: int = video_files.COUNT) -> Path:
    """A recording as the app writes it, of a phone whose clock began long ago."""
    folder.mkdir()
    video_files.write(folder / "rgb.mp4", "libx264")
    (folder / "calibration.yaml").unlink()
    (folder / "camera_matrix.csv").write_text("50.0, 0.0, 31.5\n0.0, 50.0, 23.5\n0.0, 0.0, 1.0")
    rows = [
        f"{2934.5 + 0.05 * n}, {n:06d}, {0.1 * n}, 0.0, -0.5, 0.0, 0.0, 0.6, 0.8\n"
        for n in range(poses)
    ]
    head = "timestamp, frame, x, y, z, qx, qy, qz, qw\n"
    (folder / "odometry.csv").write_text(head + "".join(rows))
    rows = [f"{2934.4 + 0.01 * n}, 0.0, -1.0, 0.01, 0.1, 0.2, 0.3\n" for n in range(250)]
    head = "timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z\n"
    (folder / "imu.csv").write_text(head + "".join(rows))
    return folder


def test_stray_scanner(tmp_path: Path) -> None:
    source = open_source(stray(tmp_path / "71de12f9"))
    assert (source.format, source.name) == ("stray", "71de12f9")
    assert source.rig.cam0.fx == 50.0
    assert source.stamps_ns[[0, 1]].tolist() == [2_934_500_000_000, 2_934_550_000_000]
    truth = source.ground_truth
    assert truth is not None
    assert truth.positions[3].tolist() == pytest.approx([0.3, 0.0, -0.5])
    assert truth.world_from_cam[0, :3, 0].tolist() == pytest.approx([0.28, 0.96, 0.0])
    imu = source.imus[0]
    # CoreMotion has g and the direction of gravity: here the phone is upright, its y upwards.
    assert imu.read().accel[0].tolist() == pytest.approx([0.0, 9.80665, -0.0980665])
    pose = imu.cam0_from_imu
    assert pose is not None  # held upright, the landscape image has down to its left
    assert (pose[:3, :3] @ [0.0, 1.0, 0.0]).tolist() == [-1.0, 0.0, 0.0]
    assert [video_files.number(f.image0) for f in source.frames(0, 3)] == [0, 1, 2]


def test_stray_scanner_with_missing_poses_or_other_columns(tmp_path: Path) -> None:
    folder = stray(tmp_path / "a", poses=9)
    with pytest.raises(SourceError, match=r"40 images but 9 poses.*rgb\.mp4"):
        open_source(folder)
    (folder / "odometry.csv").write_text("1.0, 2.0, 3.0\n" * 40)
    with pytest.raises(SourceError, match="other columns than timestamp, frame, x"):
        open_source(folder)
    (folder / "odometry.csv").unlink()
    assert open_source(folder).ground_truth is None


def photograph(path: Path, focal_mm: tuple[int, int], equivalent_mm: int) -> Path:
    """A JPEG with a focal length, as a rational, and its equivalent, in a further directory."""
    first = struct.pack(">HHHII", 1, 0x8769, 4, 1, 26) + bytes(4)
    entries = struct.pack(">HHII", 0x920A, 5, 1, 56) + struct.pack(
        ">HHIHH", 0xA405, 3, 1, equivalent_mm, 0
    )
    further = struct.pack(">H", 2) + entries + bytes(4)
    tiff = b"MM\0*" + struct.pack(">I", 8) + first + further + struct.pack(">II", *focal_mm)
    content = b"Exif\0\0" + tiff
    data = cv2.imencode(".jpg", layouts.image(0))[1].tobytes()
    segment = b"\xff\xe1" + struct.pack(">H", len(content) + 2) + content
    path.write_bytes(data[:2] + segment + data[2:])
    return path


def test_focal_length_of_a_photograph(tmp_path: Path) -> None:
    path = photograph(tmp_path / "a.jpg", (425, 100), 26)
    hint = camera_hint(tmp_path, ImageFile(path), (4000, 3000))
    assert hint.focal_px == pytest.approx(26 / np.hypot(36, 24) * 5000)
    assert hint.sigma_px == pytest.approx(0.05 * hint.focal_px)
    assert hint.told_by == "EXIF: 26 mm of 35 mm film"
    path = photograph(tmp_path / "b.jpg", (425, 100), 0)
    assert not camera_hint(tmp_path, ImageFile(path), (4000, 3000)).is_known  # pixels per mm?


@pytest.mark.parametrize("name", ["IMG_0042.mov", "copy.mp4"])
def test_focal_length_of_an_iphone(tmp_path: Path, name: str) -> None:
    clip = tmp_path / name
    with av.open(str(clip), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata["com.apple.quicktime.camera.focal_length.35mm_equivalent"] = "26"
        container.metadata["com.apple.quicktime.model"] = "iPhone 15 Pro"
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = layouts.WIDTH, layouts.HEIGHT, "yuv420p"
        for n in range(3):
            frame = av.VideoFrame.from_ndarray(video_files.picture(n), format="gray")
            container.mux(stream.encode(frame.reformat(format="yuv420p")))
        container.mux(stream.encode())
    layouts.write_text(tmp_path / "calibration.yaml", layouts.CALIBRATION)
    source = open_source(clip)
    hint = camera_hint(clip, source.first_image, (1920, 1080))
    assert hint.focal_px == pytest.approx(26 / np.hypot(36, 24) * np.hypot(1920, 1080))
    assert hint.sigma_px == pytest.approx(0.15 * hint.focal_px)
    text = CliRunner().invoke(app, ["info", str(clip)]).stdout
    assert "iPhone 15 Pro, focal length 48 px by 26 mm of 35 mm film" in text


def test_positions_beside_a_video(tmp_path: Path) -> None:
    clip = video_files.write(tmp_path / "DJI_0042.mp4", "libx264")
    with pytest.raises(
        SourceError, match=r"no positions in it \(GPMF, CAMM\), or beside it.*DJI_0042\.srt"
    ):
        read_positions("auto", str(clip))
    cues = "".join(
        f"{n + 1}\n00:00:0{n},000 --> 00:00:0{n},900\n"
        f"[latitude: 47.{n}] [longitude: 8.5] [rel_alt: 1.3 abs_alt: 412.5]\n\n"
        for n in range(3)
    )
    clip.with_suffix(".SRT").write_text(cues)
    assert read_positions("auto", str(clip)).stamps_ns.tolist() == [0, 10**9, 2 * 10**9]


def test_info_names_what_is_in_a_clip(shared_data: Path) -> None:
    clip = shared_data / "gopro" / "max-heromode.mp4"
    text = CliRunner().invoke(app, ["info", str(clip)]).stdout
    for part in (
        "GoPro Max, lens W, stabilised (HS HLevel), rows read within 20.6 ms",
        "191 positions of GPS (--gps auto)",
        "focal length 406 px by GoPro, 137° between corners",
        "(GPMF): 2082 samples",
        "was stabilised in the camera (HS HLevel)",
        "try: vo run",
    ):
        assert part in text
    positions = read_positions("auto", str(clip))
    assert (positions.source, len(positions.stamps_ns)) == ("gps", 191)
