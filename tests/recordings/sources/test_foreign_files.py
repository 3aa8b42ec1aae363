"""Files that are not read: what they are, and the command that converts them; UTF-16 text."""

from __future__ import annotations

import gzip
import re
import shutil
import subprocess
import tarfile
from pathlib import Path

import layouts
import pytest

from vo.base.errors import CalibrationError, SourceError
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.formats.foreign_files import KINDS, foreign_message
from vo.recordings.sources.registry import FORMATS, open_source

HEADS = {
    "raw.h264": (b"\0\0\0\1\x67\x64", "raw H.264 video, which has no times"),
    "raw.mjpeg": (b"\xff\xd8\xff\xe0", "-f mjpeg -framerate 30"),
    "raw.265": (b"\0\0\0\1\x40\x01\x0c", "raw H.265 video"),
    "rec.vrs": (b"VisionRe", "vrs extract-images"),
    "events.aedat4": (b"#!AER-DAT4.0\r\n", "event camera"),
    "rec.hdf5": (b"\x89HDF\r\n\x1a\n", "h5ls -r"),
    "rec.rrd": (b"RRF2", "rerun viewer"),
    "rec.svo2": (b"", "ZED_SVO_Export"),
    "rec.r3d": (b"PK\x03\x04", "Record3D"),
    "scene0000_00.sens": (b"\x04\0\0\0", "ScanNet"),
    "images.zip": (b"PK\x03\x04", "unzip"),
    "images.tar.gz": (b"\x1f\x8b\x08", "tar xf"),
    "log.bag.gz": (b"\x1f\x8b\x08", "gzip -dc"),
    "log.mcap.zst": (b"\x28\xb5\x2f\xfd", "-dc {file} | vo run - -o OUT"),
    "walk.SRT": (b"", "`positions={file}`"),
    "walk.kml": (b"", "gpsbabel -i kml"),
    "a.HEIC": (b"\0\0\0\x18ftypheic", "magick mogrify -format jpg"),
    "a.dng": (b"II*\0", "raw photograph"),
    "a.exr": (b"v/1\x01", "OpenEXR"),
}


def _message(path: Path, **options: str) -> str:
    with pytest.raises(SourceError) as caught:
        open_source(path, **options)  # type: ignore[arg-type]
    return str(caught.value)


@pytest.mark.parametrize("name", HEADS)
def test_file_is_named(tmp_path: Path, name: str) -> None:
    head, expected = HEADS[name]
    path = tmp_path / name
    path.write_bytes(head + b"\0" * 600)
    message = _message(path)
    assert message.startswith(f"{path} is ")
    assert expected.format(file=path) in message
    if name != "raw.mjpeg" and head and head != b"II*\0" and not name.endswith("sens"):
        bare = path.rename(tmp_path / "unnamed")
        assert _message(bare, format="video").startswith(f"{bare} is ")


def test_no_kind_has_the_suffix_of_a_recording() -> None:
    suffixes = {suffix for entry in FORMATS.values() for suffix in entry.suffixes}
    assert not suffixes & {suffix for kind in KINDS for suffix in kind.suffixes}


@pytest.mark.parametrize("layout", layouts.WRITERS)
def test_recordings_are_no_foreign_files(tmp_path: Path, layout: str) -> None:
    path = tmp_path / layouts.PATHS.get(layout, layout)
    layouts.WRITERS[layout](path)
    if layout != "glob":
        assert foreign_message(path) == ""
    for file in path.rglob("*.db3"):
        assert len(open_source(file)) == layouts.COUNT


def test_images_whose_suffix_is_wrong(tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / f"{number}.jpg").write_bytes(b"\0\0\0\x18ftypheic" + b"\0" * 99)
    assert "0.jpg is a HEIC image: convert such images with `magick" in _message(tmp_path)


def test_folder_of_foreign_images(tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / f"IMG_{number}.HEIC").write_bytes(b"\0\0\0\x18ftypheic")
    message = _message(tmp_path)
    assert f"{tmp_path}/IMG_0.HEIC is a HEIC image (3 such files)" in message
    assert f"magick mogrify -format jpg {tmp_path}/*.HEIC" in message


def test_folder_of_folders_with_images(tmp_path: Path) -> None:
    for name in ("colour", "thermal"):
        layouts.write_image(tmp_path / name / "0.png", layouts.image(0))
    assert _message(tmp_path).endswith(
        f"has no images, but folders with images: give {tmp_path}/colour, or of thermal"
    )


@pytest.mark.parametrize("name", ["log.mcap.gz", "log.mcap"])
def test_advice_on_a_packed_log(tmp_path: Path, name: str) -> None:
    whole = tmp_path / "whole.mcap"
    layouts.WRITERS["mcap"](whole)
    path = tmp_path / name
    path.write_bytes(gzip.compress(whole.read_bytes()))
    unpack = re.findall(r"`(gzip -dc [^`|]*)`", _message(path))[0]
    subprocess.run(unpack, shell=True, check=True)
    assert len(open_source(unpack.rpartition(" ")[2])) == layouts.COUNT


def test_advice_on_a_tar_archive(tmp_path: Path) -> None:
    layouts.write_folder(tmp_path / "walk")
    archive = tmp_path / "walk.tar.gz"
    with tarfile.open(archive, "w:gz") as tar:
        tar.add(tmp_path / "walk", "walk")
    shutil.rmtree(tmp_path / "walk")
    (command,) = re.findall(r"`(tar xf [^`]*)`", _message(archive))
    subprocess.run(command, shell=True, check=True, cwd=tmp_path)
    assert len(open_source(tmp_path / "walk")) == layouts.COUNT


# Calibrations


def test_text_in_utf_16(tmp_path: Path) -> None:
    layouts.write_folder(tmp_path)
    for name in ("calibration.yaml", "times.txt"):
        text = (tmp_path / name).read_text("utf-8").replace("\n", "\r\n")
        (tmp_path / name).write_bytes(text.encode("utf-16"))
    assert open_source(tmp_path).stamps_ns.tolist() == layouts.STAMPS_NS


def test_camera_matrices(tmp_path: Path) -> None:
    stray = tmp_path / "camera_matrix.csv"
    stray.write_text("1591.5, 0.0, 952.1\n0.0, 1592.5, 714.2\n0.0, 0.0, 1.0\n")
    scannet = tmp_path / "intrinsic_color.txt"
    scannet.write_text("1591.5 0 952.1 0\n0 1592.5 714.2 0\n0 0 1 0\n0 0 0 1\n")
    for file in (stray, scannet):
        camera = read_calibration(file, (1920, 1440)).rig.cam0
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (1591.5, 1592.5, 952.1, 714.2)
        assert (camera.width, camera.height) == (1920, 1440)
    pose = tmp_path / "pose.txt"
    pose.write_text("1 0 0 2\n0 1 0 3\n0 0 1 4\n0 0 0 1\n")
    with pytest.raises(CalibrationError, match="not a calibration file"):
        read_calibration(pose, (1920, 1440))


def test_camera_model_of_robotcar(tmp_path: Path) -> None:
    file = tmp_path / "stereo_wide_left.txt"
    file.write_text("983.04 983.04 643.6 493.4\n0 0 1 0\n1 0 0 0\n0 1 0 0\n0 0 0 1\n")
    with pytest.raises(CalibrationError, match=r"RobotCar.*\[983\.04, 983\.04, 643\.6, 493\.4\]"):
        read_calibration(file, (1280, 960))
