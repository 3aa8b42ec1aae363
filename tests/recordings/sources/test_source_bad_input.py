"""Invalid recordings: an error of one line, or a warning."""

from __future__ import annotations

import shutil
from pathlib import Path

import layouts
import numpy as np
import pytest

from vo.base.errors import CalibrationError, SourceError, VoError
from vo.recordings.sources.registry import open_source


def _message(path: Path, kind: type[VoError], **options: object) -> str:
    with pytest.raises(kind) as caught:
        open_source(path, **options)  # type: ignore[arg-type]
    message = str(caught.value)
    assert "\n" not in message
    return message


def _edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def _indices(path: Path) -> list[int]:
    return [frame.index for frame in open_source(path).frames()]


# What is not a recording


def test_error_for_a_missing_folder(tmp_path: Path) -> None:
    assert _message(tmp_path / "nowhere", SourceError).startswith(f"{tmp_path}/nowhere does not")


def test_error_for_a_folder_without_images(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no images here")
    message = _message(tmp_path, SourceError)
    assert f"folder {tmp_path} has no images" in message
    assert "image_0 (kitti)" in message


def test_error_for_a_layout_without_images(kitti: Path) -> None:
    shutil.rmtree(kitti / "image_0")
    (kitti / "image_0").mkdir()
    assert f"folder {kitti}/image_0 has no images" in _message(kitti, SourceError)


def test_error_for_a_file_of_unknown_format(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no recording")
    assert "file of unknown format" in _message(tmp_path / "notes.txt", SourceError)


def test_error_for_an_unknown_format(kitti: Path) -> None:
    message = _message(kitti, SourceError, format="kity")
    assert message.startswith("format 'kity' is unknown; known formats: ")


def test_error_names_what_a_format_lacks(folder: Path) -> None:
    assert "image_0 does not exist" in _message(folder, SourceError, format="kitti")


# Images


@pytest.mark.parametrize("content", [b"", b"no image", b"\x89PNG\r\n\x1a\nno chunks"])
def test_damaged_image_in_the_middle_is_skipped(
    kitti: Path, content: bytes, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    (kitti / "image_0/000002.png").write_bytes(content)
    assert _indices(kitti) == [0, 1, 3, 4, 5]
    assert len(caplog.records) == 1
    assert "frame 2 skipped: image " in caplog.text
    assert capfd.readouterr() == ("", "")


def test_damaged_first_image_is_skipped(kitti: Path) -> None:
    (kitti / "image_0/000000.png").write_bytes(b"")
    assert _indices(kitti) == [1, 2, 3, 4, 5]


def test_damaged_right_image_leaves_the_left_one(
    kitti: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (kitti / "image_1/000002.png").write_bytes(b"")
    source = open_source(kitti)
    assert [f.image1 is None for f in source.frames()] == [False] * 2 + [True] + [False] * 3
    assert source.unpaired == 1
    assert source.skipped == []
    assert "frame 2 used without its right image" in caplog.text


def test_error_without_a_readable_image(kitti: Path) -> None:
    for path in (kitti / "image_0").iterdir():
        path.write_bytes(b"")
    message = _message(kitti, SourceError)
    assert "none of 6 images can be read" in message
    assert "000000.png is empty" in message


def test_image_of_another_size_in_the_middle_is_skipped(
    folder_recording: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = open_source(folder_recording)
    shot = source._left[4]  # type: ignore[attr-defined]
    layouts.write_image(Path(shot.image.name), np.zeros((20, 30), np.uint8))
    caplog.clear()
    assert [f.index for f in source.frames()] == [0, 1, 2, 3, 5]
    assert "is 30x20, but those of the camera are 64x48" in source.skipped[0].reason
    assert len(caplog.records) == 1


def test_error_for_images_of_another_size_than_the_calibration(folder: Path) -> None:
    _edit(folder / "calibration.yaml", "[64, 48]", "[640, 480]")
    message = _message(folder, CalibrationError)
    file = folder / "calibration.yaml"
    assert f"are 64x48, but the calibration {file} (vo) is for 640x480; give a" in message
    assert "`calibration=FILE`" in message


def test_error_for_right_images_of_another_size_than_the_calibration(kitti: Path) -> None:
    for path in (kitti / "image_1").iterdir():
        layouts.write_image(path, np.zeros((20, 30), np.uint8))
    message = _message(kitti, CalibrationError)
    file = kitti / "calib.txt"
    assert f"are 30x20, but the calibration {file} (KITTI) is for 64x48" in message


# Calibration


@pytest.mark.parametrize(
    ("layout", "file"),
    [
        ("kitti", "calib.txt"),
        ("euroc", "mav0/cam0/sensor.yaml"),
        ("tum", "calibration.yaml"),
        ("folder", "calibration.yaml"),
    ],
)
def test_error_for_a_missing_calibration(tmp_path: Path, layout: str, file: str) -> None:
    layouts.WRITERS[layout](tmp_path / layout)
    (tmp_path / layout / file).unlink()
    message = _message(tmp_path / layout, CalibrationError)
    assert f"{layout}/{file}" in message
    assert "`calibration=FILE`" in message
    assert "docs/calibration.md" in message


def test_error_for_a_missing_given_calibration(kitti: Path) -> None:
    message = _message(kitti, CalibrationError, calibration=kitti / "none.yaml")
    assert message == f"calibration file {kitti}/none.yaml does not exist"


@pytest.mark.parametrize(("value", "found"), [(".nan", "is nan"), ("-50.0", "is -50, 51")])
def test_error_for_an_implausible_calibration(tum: Path, value: str, found: str) -> None:
    _edit(tum / "calibration.yaml", "[50.0", f"[{value}")
    message = _message(tum, CalibrationError)
    assert str(tum / "calibration.yaml") in message
    assert found in message


# Stamps


def test_error_for_more_images_than_stamps(kitti: Path) -> None:
    _edit(kitti / "times.txt", layouts.seconds(layouts.STAMPS_NS[-1]), "")
    message = _message(kitti, SourceError)
    assert "image_0 has 6 images" in message
    assert "times.txt has 5 stamps" in message


def test_error_for_fewer_images_than_stamps(folder: Path) -> None:
    (folder / "left/frame9.png").unlink()
    message = _message(folder, SourceError)
    assert "left has 5 images" in message
    assert "times.txt has 6 stamps" in message


def test_error_for_missing_times(kitti: Path) -> None:
    (kitti / "times.txt").unlink()
    assert "times.txt is missing" in _message(kitti, SourceError)


@pytest.mark.parametrize(
    ("layout", "file", "line"),
    [
        ("kitti", "times.txt", 4),
        ("euroc", "mav0/cam0/data.csv", 5),
        ("tum", "rgb.txt", 6),
        ("folder", "times.txt", 4),
    ],
)
def test_error_for_stamps_that_do_not_increase(
    tmp_path: Path, layout: str, file: str, line: int
) -> None:
    layouts.WRITERS[layout](tmp_path / layout)
    table = tmp_path / layout / file
    a, b = layouts.STAMPS_NS[2:4]
    lines = table.read_text().splitlines(keepends=True)
    lines[line - 2], lines[line - 1] = lines[line - 1], lines[line - 2]
    table.write_text("".join(lines))
    message = _message(tmp_path / layout, SourceError)
    assert message.startswith(f"{table}:{line}: stamp {a} ns is not after {b} ns")


def test_error_for_a_repeated_stamp(tum: Path) -> None:
    stamps = [layouts.seconds(s) for s in layouts.STAMPS_NS]
    _edit(tum / "rgb.txt", f"{stamps[1]} ", f"{stamps[0]} ")
    assert "rgb.txt:4: stamp" in _message(tum, SourceError)


@pytest.mark.parametrize(
    ("layout", "file", "line"),
    [
        ("kitti", "times.txt", "12.3.4"),
        ("kitti", "times.txt", "nan"),
        ("euroc", "mav0/cam0/data.csv", "1600000000.5,a.png"),
        ("euroc", "mav0/cam0/data.csv", "1600000000123456789"),
        ("tum", "rgb.txt", "yesterday rgb/1.png"),
        ("tum", "rgb.txt", "1600000000.5"),
        ("tum", "rgb.txt", "1e300 rgb/1.png"),
    ],
)
def test_error_for_invalid_lines(tmp_path: Path, layout: str, file: str, line: str) -> None:
    layouts.WRITERS[layout](tmp_path / layout)
    table = tmp_path / layout / file
    table.write_text(f"{line}\n{table.read_text()}")
    assert _message(tmp_path / layout, SourceError).startswith(f"{table}:1: ")


def test_error_for_a_table_that_is_not_text(tum: Path) -> None:
    (tum / "rgb.txt").write_bytes(b"\xff\x00\x81")
    assert "rgb.txt is not text" in _message(tum, SourceError)


def test_error_for_an_empty_table(euroc: Path) -> None:
    (euroc / "mav0/cam0/data.csv").write_text("#timestamp [ns],filename\n")
    assert "data.csv has no data" in _message(euroc, SourceError)


def test_table_with_some_missing_files(euroc: Path, caplog: pytest.LogCaptureFixture) -> None:
    (euroc / f"mav0/cam0/data/{layouts.STAMPS_NS[0]}.png").unlink()
    (euroc / f"mav0/cam0/data/{layouts.STAMPS_NS[3]}.png").unlink()
    assert _indices(euroc) == [1, 2, 4, 5]
    assert [r.message.split(":")[0] for r in caplog.records] == [
        "frame 0 skipped",
        "the same for 1 more frames as for frame 0, up to frame 3",
    ]


def test_error_for_a_table_with_only_missing_files(euroc: Path) -> None:
    shutil.rmtree(euroc / "mav0/cam0/data")
    message = _message(euroc, SourceError)
    assert "none of the 6 images" in message
    assert f"{layouts.STAMPS_NS[0]}.png" in message


# The right camera


def test_right_camera_missing(folder_recording: Path) -> None:
    for name in ("image_1", "image_01", "mav0/cam1", "undistorted_images/cam1", "right"):
        shutil.rmtree(folder_recording / name, ignore_errors=True)
    message = _message(folder_recording, SourceError, mode="stereo")
    assert f"{folder_recording.name} has no images of a right camera" in message
    assert not open_source(folder_recording).rig.is_stereo


def test_right_folder_without_images(kitti: Path) -> None:
    shutil.rmtree(kitti / "image_1")
    (kitti / "image_1").mkdir()
    assert not open_source(kitti).rig.is_stereo
    assert "no images of a right camera" in _message(kitti, SourceError, mode="stereo")


def test_right_camera_without_calibration(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    _edit(folder / "calibration.yaml", "baseline_m: 0.12", "")
    assert not open_source(folder).rig.is_stereo
    assert "cam1 is not calibrated" in caplog.text
    assert "has no right camera" in _message(folder, CalibrationError, mode="stereo")


def test_right_camera_of_another_time(euroc: Path, caplog: pytest.LogCaptureFixture) -> None:
    table = euroc / "mav0/cam1/data.csv"
    table.write_text("".join(f"{s + 50_000_000},{s}.png\n" for s in layouts.STAMPS_NS))
    assert "no left image has a right image" in _message(euroc, SourceError, mode="stereo")
    caplog.clear()
    source = open_source(euroc)
    assert not source.rig.is_stereo
    assert all(frame.image1 is None for frame in source.frames())
    assert "only the left camera is used" in caplog.text


# Ground truth never stops a run


@pytest.mark.parametrize(
    ("layout", "file"),
    [
        ("kitti", "poses.txt"),
        ("euroc", "mav0/state_groundtruth_estimate0/data.csv"),
        ("tum", "groundtruth.txt"),
        ("folder", "groundtruth.tum"),
    ],
)
@pytest.mark.parametrize("content", [b"", b"1 2 3\n", b"\xff\x00\x81", b"nan " * 12])
def test_broken_ground_truth(
    tmp_path: Path, layout: str, file: str, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    layouts.WRITERS[layout](tmp_path / layout)
    (tmp_path / layout / file).write_bytes(content)
    source = open_source(tmp_path / layout)
    assert source.ground_truth is None
    assert len(list(source.frames())) == layouts.COUNT
    assert len(caplog.records) == 1
    assert "ground truth not used: " in caplog.text
    assert file in caplog.text


def test_no_ground_truth(folder_recording: Path, caplog: pytest.LogCaptureFixture) -> None:
    if folder_recording.name == "nerf":
        pytest.skip("the file of the camera always has the poses")
    for name in ("poses.txt", "groundtruth.txt", "groundtruth.tum", "GNSSPoses.txt"):
        (folder_recording / name).unlink(missing_ok=True)
    for name in ("mav0/state_groundtruth_estimate0", "oxts"):
        shutil.rmtree(folder_recording / name, ignore_errors=True)
    assert open_source(folder_recording).ground_truth is None
    assert caplog.records == []


@pytest.mark.parametrize(("rows", "used"), [(4, 4), (8, 6)])
def test_other_number_of_poses_than_images(
    kitti: Path, rows: int, used: int, caplog: pytest.LogCaptureFixture
) -> None:
    lines = (kitti / "poses.txt").read_text().splitlines()
    (kitti / "poses.txt").write_text("\n".join((lines + lines[-1:] * 2)[:rows]))
    truth = open_source(kitti).ground_truth
    assert truth is not None
    assert truth.stamps_ns.tolist() == layouts.STAMPS_NS[:used]
    assert f"has {rows} poses for 6 images; the first {used} are used" in caplog.text


def test_a_calibration_of_another_name_is_mentioned(tmp_path: Path) -> None:
    layouts.write_folder(tmp_path)
    other = (tmp_path / "calibration.yaml").rename(tmp_path / "camera params.yml")
    with pytest.raises(CalibrationError) as caught:
        open_source(tmp_path)
    assert f"{other} is one: if it is that of these images, give `calibration={other}`" in str(
        caught.value
    )
    other.unlink()
    with pytest.raises(CalibrationError, match=r"give one with `calibration=FILE` \(format"):
        open_source(tmp_path)


@pytest.mark.parametrize("name", ["../secret.png", "/{parent}/secret.png", "rgb/../../secret.png"])
@pytest.mark.parametrize("layout", ["tum", "euroc"])
def test_images_outside_of_the_recording(layout: str, name: str, tmp_path: Path) -> None:
    layouts.WRITERS[layout](tmp_path / layout)
    table = {"tum": "rgb.txt", "euroc": "mav0/cam0/data.csv"}[layout]
    (tmp_path / "secret.png").touch()
    file = tmp_path / layout / table
    lines = file.read_text("utf-8").splitlines()
    up = "../" * (table.count("/") + 1)
    escaped = name.format(parent=tmp_path).replace("../secret", f"{up}secret")
    end = lines[-1].replace(",", " ").split()[-1]
    lines[-1] = lines[-1].replace(end, escaped)
    file.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(SourceError, match=r"secret\.png is outside of the recording"):
        open_source(tmp_path / layout)
