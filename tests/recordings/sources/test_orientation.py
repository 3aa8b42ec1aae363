"""Photographs that EXIF asks to turn, and files that Git has not fetched."""

from __future__ import annotations

import logging
import struct
from pathlib import Path

import cv2
import layouts
import numpy as np
import pytest
from typer.testing import CliRunner

from vo.base.errors import CalibrationError, SourceError, VoError
from vo.cli.app import app
from vo.outputs.evaluation.inputs import load_inputs
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.sources.orientation import exif_orientation
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.uncalibrated import open_uncalibrated

POINTER = (
    "version https://git-lfs.github.com/spec/v1\n"
    "oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1258daaa5e2ca24d17e2393\n"
    "size 91234567\n"
)
NOT_FETCHED = "is a Git LFS pointer, not the file: git lfs pull"


def exif(orientation: int, order: str) -> bytes:
    """A segment as phones write it: the maker's name, and the orientation."""
    mark = {"<": b"II*\0", ">": b"MM\0*"}[order]
    entries = struct.pack(f"{order}HHII", 0x010F, 2, 4, 0x41424300)
    entries += struct.pack(f"{order}HHIHH", 0x0112, 3, 1, orientation, 0)
    tiff = mark + struct.pack(f"{order}IH", 8, 2) + entries + bytes(4)
    content = b"Exif\0\0" + tiff
    return b"\xff\xe1" + struct.pack(">H", len(content) + 2) + content


def photograph(path: Path, index: int, orientation: int, order: str = ">") -> Path:
    data = cv2.imencode(".jpg", layouts.image(index))[1].tobytes()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data[:2] + exif(orientation, order) + data[2:])
    return path


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_read_as_by_opencv(tmp_path: Path, orientation: int, order: str) -> None:
    path = photograph(tmp_path / "a.jpg", 0, orientation, order)
    assert exif_orientation(path.read_bytes()) == orientation
    shape = cv2.imread(str(path)).shape[:2]
    assert (shape == (layouts.WIDTH, layouts.HEIGHT)) == (orientation >= 5)


def test_damaged_exif_is_upright(tmp_path: Path) -> None:
    data = photograph(tmp_path / "a.jpg", 0, 6).read_bytes()
    for length in range(60):
        assert exif_orientation(data[:length]) in (1, 6)
    assert exif_orientation(b"") == exif_orientation(b"\x89PNG") == 1


def test_images_are_used_as_stored_by_all_commands(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    folder = tmp_path / "walk"
    for i in range(4):
        photograph(folder / f"{i}.jpg", i, 6 if i % 2 else 1)
    layouts.write_text(tmp_path / "calibration.yaml", layouts.CALIBRATION)
    for source in (open_source(folder), open_uncalibrated(folder)):
        for kind in ("grey", "colour", "recorded"):
            images = [frame.image0 for frame in source.frames(images=kind)]
            assert {image.shape[:2] for image in images} == {(layouts.HEIGHT, layouts.WIDTH)}
            assert not source.skipped
    assert caplog.text.count("EXIF asks to turn 2 of 4 checked images, such as 1.jpg") == 2
    result = CliRunner().invoke(app, ["info", str(folder)])
    assert "EXIF asks to turn 2 of 4 checked images" in " ".join(result.output.split())
    assert "other sizes" not in result.output


def test_calibration_of_turned_images_is_named(tmp_path: Path) -> None:
    photograph(tmp_path / "walk" / "0.jpg", 0, 6)
    size = f"[{layouts.WIDTH}, {layouts.HEIGHT}]"
    turned = layouts.CALIBRATION.replace(size, f"[{layouts.HEIGHT}, {layouts.WIDTH}]")
    turned = turned.replace(str(layouts.INTRINSICS), "[51.0, 50.0, 23.5, 31.5]")
    layouts.write_text(tmp_path / "calibration.yaml", turned)
    with pytest.raises(CalibrationError, match="images turned by 90 degrees"):
        open_source(tmp_path / "walk")


@pytest.mark.parametrize("name", ["a.mcap", "a.bag", "a.db3", "a.mp4", "a.avi"])
def test_pointers_to_recordings(tmp_path: Path, name: str) -> None:
    layouts.write_text(tmp_path / name, POINTER)
    for command in ("info", "run"):
        out = ["-o", str(tmp_path / "out")] if command == "run" else []
        result = CliRunner().invoke(app, [command, str(tmp_path / name), *out])
        assert result.exit_code == 1
        assert f"{name} {NOT_FETCHED}" in result.output


def test_pointers_in_recordings(tmp_path: Path) -> None:
    layouts.write_rosbag2(tmp_path / "bag")
    (database,) = (tmp_path / "bag").glob("*.db3")
    layouts.write_text(database, POINTER)
    with pytest.raises(SourceError, match=f"db3 {NOT_FETCHED}"):
        open_source(tmp_path / "bag")
    layouts.write_folder(tmp_path / "folder")
    for image in (tmp_path / "folder").rglob("*.png"):
        layouts.write_text(image, POINTER)
    with pytest.raises(SourceError, match=NOT_FETCHED):
        open_source(tmp_path / "folder")
    layouts.write_euroc(tmp_path / "euroc")
    layouts.write_text(tmp_path / "euroc/mav0/cam0/data.csv", POINTER)
    with pytest.raises(SourceError, match=NOT_FETCHED):
        open_source(tmp_path / "euroc")


def test_pointers_to_calibrations_and_trajectories(tmp_path: Path) -> None:
    layouts.write_text(tmp_path / "a.yaml", POINTER)
    layouts.write_text(tmp_path / "a.tum", "0.0 0 0 0 0 0 0 1\n")
    with pytest.raises(CalibrationError, match=NOT_FETCHED):
        read_calibration(tmp_path / "a.yaml")
    for pair in (
        (tmp_path / "a.yaml", tmp_path / "a.tum"),
        (tmp_path / "a.tum", tmp_path / "a.yaml"),
    ):
        with pytest.raises(VoError, match=NOT_FETCHED):
            load_inputs(*pair)


def test_one_image_that_is_not_fetched_loses_only_its_frame(tmp_path: Path) -> None:
    layouts.write_folder(tmp_path)
    layouts.write_text(sorted((tmp_path / "left").glob("*.png"))[2], POINTER)
    source = open_source(tmp_path)
    assert len(list(source.frames())) == layouts.COUNT - 1
    assert NOT_FETCHED in source.skipped[0].reason
    assert np.array_equal(next(iter(source.frames(3))).image0, layouts.image(3))
