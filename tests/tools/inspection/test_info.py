"""Inspection of damaged recordings: findings and advice."""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from mcap.writer import Writer
from typer.testing import CliRunner

from data_synth.cameras import camera_file
from vo.base.types import Bytes
from vo.cli.app import app
from vo.recordings.formats.foxglove import FOXGLOVE
from vo.recordings.formats.messages import ImageMessage
from vo.tools.inspection.images import write_contact_sheet
from vo.tools.inspection.inspection import inspect
from vo.tools.inspection.opening import open_leniently
from vo.tools.inspection.reports import Finding, Report


def report_of(path: Path, images: int | None = 8) -> Report:
    return inspect(open_leniently(path), images)


def finding(report: Report, words: str) -> Finding:
    found = [each for each in report.findings if words in each.what]
    assert len(found) == 1, [each.what for each in report.findings]
    return found[0]


@pytest.fixture
def walk(synthetic_stereo: Path, tmp_path: Path) -> Path:
    """A copy that tests may modify."""
    return Path(shutil.copytree(synthetic_stereo, tmp_path / "walk"))


def modify_images(
    walk: Path, change: Callable[[Bytes], Bytes], frames: slice, camera: str = "cam0"
) -> None:
    for file in sorted((walk / "mav0" / camera / "data").iterdir())[frames]:
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        assert cv2.imwrite(str(file), change(np.asarray(image, dtype=np.uint8)))


def test_a_sound_recording_has_no_findings(synthetic_stereo: Path) -> None:
    report = report_of(synthetic_stereo)
    assert report.findings == ()
    left = report.cameras[0]
    assert (left.timing.count, left.timing.gaps, left.timing.repeated_stamps) == (30, (), 0)
    assert report.pair is not None and report.pair.pairs == 30
    assert report.calibration is not None and report.calibration.is_rectified
    width_deg = report.calibration.lenses[0].view_deg[0]
    lens = report.calibration.lenses[0]
    half = np.degrees(np.arctan(0.5 * (lens.width - 1) / lens.fx))
    assert width_deg == pytest.approx(2 * half, abs=0.2)
    assert report.stereo is not None and abs(report.stereo.row_offset_px) < 0.2
    assert report.stereo.positive > 0.95
    assert report.truth is not None and report.truth.covered == 1.0
    assert report.command.startswith("vo run ") and "--" not in report.command


def test_swapped_cameras_are_detected_in_the_images(walk: Path) -> None:
    mav0 = walk / "mav0"
    for name in ("data", "data.csv"):
        (mav0 / "cam0" / name).rename(mav0 / f"{name}.left")
        (mav0 / "cam1" / name).rename(mav0 / "cam0" / name)
        (mav0 / f"{name}.left").rename(mav0 / "cam1" / name)
    report = report_of(walk)
    assert finding(report, "exchanged").level == "error"
    assert report.command.endswith("--mode mono")


def test_a_baseline_in_millimetres_is_reported(walk: Path) -> None:
    sensor = walk / "mav0" / "cam1" / "sensor.yaml"
    data = yaml.safe_load(sensor.read_text())
    left = yaml.safe_load((walk / "mav0" / "cam0" / "sensor.yaml").read_text())["T_BS"]["data"]
    for row in (3, 7, 11):
        apart = data["T_BS"]["data"][row] - left[row]
        data["T_BS"]["data"][row] = left[row] + 1000.0 * apart
    sensor.write_text(yaml.safe_dump(data))
    assert "divide by 1000" in finding(report_of(walk), "which is implausible").advice


def test_pitch_error_of_the_right_camera_is_measured(walk: Path) -> None:
    modify_images(walk, lambda image: np.roll(image, 3, axis=0), slice(None), "cam1")
    report = report_of(walk)
    assert report.stereo is not None
    assert report.stereo.row_offset_px == pytest.approx(3.0, abs=0.2)
    assert report.stereo.right_camera is not None
    angle = np.rad2deg(np.arctan(3.0 / 220.0))
    assert report.stereo.right_camera.pitch_deg == pytest.approx(angle, abs=0.05)
    found = finding(report, "the right camera differs from its calibration")
    assert found.level == "warning"
    assert "vo calibrate" in found.advice
    assert not report.command.endswith("--mode mono")


def test_a_large_row_offset_is_a_wrong_calibration(walk: Path) -> None:
    modify_images(walk, lambda image: np.roll(image, 25, axis=0), slice(None), "cam1")
    report = report_of(walk)
    assert finding(report, "rows of left and right points differ").level == "error"
    assert report.command.endswith("--mode mono")


def test_no_error_is_reported_for_a_calibrated_right_camera(walk: Path) -> None:
    report = report_of(walk)
    assert report.stereo is not None
    assert report.stereo.right_camera is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda image: image // 12, "are dark"),
        (lambda image: np.minimum(image.astype(int) * 4, 255).astype(np.uint8), "over-exposed"),
        (lambda image: cv2.blur(image, (25, 5)), "blurred"),
        (lambda image: np.full_like(image, 128), "nearly without texture"),
    ],
)
def test_frames_of_poor_images_are_reported(
    walk: Path, change: Callable[[Bytes], Bytes], words: str
) -> None:
    modify_images(walk, change, slice(10, 20))
    report = report_of(walk, None)
    assert "10 of 30" in finding(report, words).what
    assert "frames 10 to 19" in finding(report, words).what


def test_repeated_images_and_gaps_are_found(walk: Path) -> None:
    files = sorted((walk / "mav0" / "cam0" / "data").iterdir())
    shutil.copy(files[6], files[7])
    table = walk / "mav0" / "cam0" / "data.csv"
    lines = table.read_text().splitlines(keepends=True)
    table.write_text("".join([*lines[:21], *lines[24:]]))  # frames 20, 21, 22
    report = report_of(walk, None)
    assert "frame 7;" in f"{finding(report, 'identical to the previous image').what};"
    assert "1 gap, about 3 images missing" in finding(report, "gap").what
    assert report.cameras[0].timing.gaps[0].after_frame == 19
    assert "0 left and 3 right images have no counterpart" in finding(report, "no counterpart").what


def test_damaged_images_are_reported(walk: Path) -> None:
    file = sorted((walk / "mav0" / "cam0" / "data").iterdir())[4]
    file.write_bytes(file.read_bytes()[:500])
    assert finding(report_of(walk, None), "unreadable").what.endswith("frame 4")


def test_images_are_inspected_without_calibration(walk: Path) -> None:
    for camera in ("cam0", "cam1"):
        (walk / "mav0" / camera / "sensor.yaml").unlink()
    (walk / "calibration.yaml").unlink()
    report = report_of(walk)
    assert report.calibration is None and len(report.cameras) == 2
    assert finding(report, "no calibration found").level == "error"
    assert report.stereo is not None and not report.stereo.rectified
    assert abs(report.stereo.row_offset_px) < 0.2
    assert report.command.endswith("--calibration camera.yaml")


def test_decreasing_stamps_are_reported_with_their_line(walk: Path) -> None:
    table = walk / "mav0" / "cam0" / "data.csv"
    lines = table.read_text().splitlines(keepends=True)
    table.write_text("".join([*lines[:5], lines[4], *lines[5:]]))
    report = report_of(walk)
    assert "data.csv:6" in finding(report, "is not after").what
    assert "--calibration" not in report.command


@pytest.fixture
def three_cameras(tmp_path: Path) -> Path:
    """A log with three cameras, of which any two may be the pair."""
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = FOXGLOVE.schema(ImageMessage)
        number = writer.register_schema(schema.name, FOXGLOVE.schema_encoding, schema.definition)
        names = ("/front", "/rear", "/top")
        channels = [
            writer.register_channel(f"{name}/image_raw", FOXGLOVE.message_encoding, number)
            for name in names
        ]
        noise = np.random.default_rng(1)
        for stamp_ns in range(10**9, 2 * 10**9, 10**8):
            for channel, name in zip(channels, names, strict=True):
                pixels = noise.integers(0, 256, 64 * 48, dtype=np.uint8).tobytes()
                message = ImageMessage(stamp_ns, name, 64, 48, "mono8", pixels)
                writer.add_message(channel, stamp_ns, FOXGLOVE.encode(message), stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def test_all_cameras_of_an_ambiguous_log_are_inspected(three_cameras: Path, tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.png"
    result = CliRunner().invoke(
        app, ["info", str(three_cameras), "--json", "--picture", str(sheet)]
    )
    assert result.exit_code == 1
    report = json.loads(result.stdout)
    assert [camera["name"] for camera in report["cameras"]] == [
        "/front/image_raw",
        "/rear/image_raw",
        "/top/image_raw",
    ]
    assert [topic["count"] for topic in report["topics"]] == [10, 10, 10]
    assert report["cameras"][0]["timing"]["rate_hz"] == pytest.approx(10.0)
    assert "which of 3 cameras" in report["findings"][0]["what"]
    assert "left=/front/image_raw" in report["command"]
    picture = cv2.imread(str(sheet), cv2.IMREAD_GRAYSCALE)
    assert picture is not None and picture.shape[1] > 1000 and picture.std() > 10


def test_the_text_ends_with_the_command(synthetic_stereo: Path) -> None:
    result = CliRunner().invoke(app, ["info", str(synthetic_stereo)])
    assert result.exit_code == 0, result.output
    assert "no problems found" in result.stdout
    assert result.stdout.splitlines()[-1].startswith(f"try: vo run {synthetic_stereo}")


def test_a_missing_path_is_a_one_line_error(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["info", str(tmp_path / "nothing")])
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1


def test_a_camera_above_the_other_is_described(walk: Path) -> None:
    for name in ("cam0", "cam1"):
        folder = walk / "mav0" / name
        modify_images(
            walk,
            lambda i: np.asarray(cv2.rotate(i, cv2.ROTATE_90_CLOCKWISE), np.uint8),
            slice(None),
            name,
        )
        sensor = yaml.safe_load((folder / "sensor.yaml").read_text())
        fu, fv, cu, cv = sensor["intrinsics"]
        width, height = sensor["resolution"]
        turn = np.eye(4)
        turn[:2, :2] = [[0, 1], [-1, 0]]  # recorded from turned
        sensor["intrinsics"] = [fv, fu, height - 1 - cv, cu]
        sensor["resolution"] = [height, width]
        pose = np.reshape(sensor["T_BS"]["data"], (4, 4)) @ turn
        sensor["T_BS"]["data"] = pose.ravel().tolist()
        (folder / "sensor.yaml").write_text(yaml.safe_dump(sensor))
    report = report_of(walk)
    assert report.findings == ()
    assert report.calibration is not None and report.calibration.cam1_is == "below"
    assert report.calibration.cam1_turned_deg == pytest.approx(0.0, abs=1e-3)
    assert report.stereo is not None and report.stereo.positive > 0.95
    assert abs(report.stereo.row_offset_px) < 0.2


def test_the_command_keeps_the_options_that_were_given(walk: Path, tmp_path: Path) -> None:
    file = tmp_path / "my camera.yaml"
    (walk / "calibration.yaml").rename(file)
    opened = open_leniently(walk, calibration=file, mode="mono")
    command = inspect(opened, 4).command
    assert shlex.split(command)[-4:] == ["--mode", "mono", "--calibration", str(file)]


def test_no_command_where_the_same_error_would_come_again(walk: Path, tmp_path: Path) -> None:
    file = tmp_path / "other.yaml"
    file.write_text("cam0: {resolution: [64, 48], intrinsics: [50, 50, 32, 24]}\n")
    report = inspect(open_leniently(walk, calibration=file), 4)
    assert report.command == ""
    problems = [each.what for each in report.findings if each.level == "error"]
    assert len(problems) == 1 and "is for 64x48; give a calibration" in problems[0]


def test_file_and_format_of_the_calibration_are_shown(walk: Path) -> None:
    report = report_of(walk)
    file = walk.resolve() / "mav0" / "cam0" / "sensor.yaml"
    assert report.calibration is not None
    assert report.calibration.source == f"{file} (EuRoC)"
    result = CliRunner().invoke(app, ["info", str(walk)])
    assert f"calibration {file} (EuRoC)" in result.stdout


def test_right_images_of_the_frame_before_are_told_with_the_shift_to_try(walk: Path) -> None:
    camera = walk / "mav0" / "cam1"
    heading, *lines = (camera / "data.csv").read_text(encoding="utf-8").splitlines()
    stamps, names = zip(*(line.split(",") for line in lines), strict=True)
    late = [",".join(row) for row in zip(stamps[1:], names[:-1], strict=True)]
    (camera / "data.csv").write_text("\n".join([heading, *late]) + "\n", encoding="utf-8")
    interval_ms = 1e-6 * float(np.median(np.diff(np.array(stamps, dtype=np.int64))))
    report = report_of(walk)
    found = finding(report, "right images show the scene")
    assert found.level == "error" and "`right_offset_ns`" in found.advice
    assert report.stereo is not None
    assert report.stereo.time_offset_ms == pytest.approx(-interval_ms, rel=0.05)
    assert "--right-offset -6" in report.command and "--mode" not in report.command
    assert not any("calibrat" in each.what for each in report.findings)


def test_one_camera_twice_is_told(walk: Path) -> None:
    for file in (walk / "mav0" / "cam0" / "data").iterdir():
        shutil.copy(file, walk / "mav0" / "cam1" / "data" / file.name)
    assert finding(report_of(walk), "the same camera twice").level == "error"


def test_a_mirrored_right_image_is_told(walk: Path) -> None:
    modify_images(walk, lambda i: np.asarray(cv2.flip(i, 1), np.uint8), slice(None), "cam1")
    assert finding(report_of(walk), "the right image is mirrored left to right").level == "error"


def noise_of(folder: Path, rig: str, cameras: int, shape: tuple[int, int]) -> Path:
    """A folder of three frames of noise, and the calibration of a rig."""
    for number in range(cameras):
        (folder / f"cam{number}").mkdir()
        for i in range(3):
            grey = np.random.default_rng(i).integers(0, 255, shape, dtype=np.uint8)
            cv2.imwrite(str(folder / f"cam{number}" / f"{10**18 + i * 10**8}.png"), grey)
    shutil.copy(camera_file(rig), folder / "calibration.yaml")
    return folder


def test_a_rig_is_described_and_drawn(tmp_path: Path) -> None:
    opened = open_leniently(noise_of(tmp_path, "car", 6, (300, 400)))
    report = inspect(opened)
    assert [camera.name for camera in report.cameras] == [f"cam{n}" for n in range(6)]
    assert report.calibration is not None and len(report.calibration.mounts) == 6
    mount = report.calibration.mounts[2]
    assert mount.turned_deg == pytest.approx(75.0, abs=0.1)
    assert set(mount.overlaps) == {"cam0", "cam1", "cam4"}
    write_contact_sheet(tmp_path / "sheet.png", opened)
    sheet = cv2.imread(str(tmp_path / "sheet.png"), cv2.IMREAD_GRAYSCALE)
    assert sheet is not None
    rig = sheet[-640:, :640]
    # Up is ahead, where two cameras see; the middle of the car is seen by none.
    assert rig[40, 320] < rig[320, 40] < 255 and rig[350, 320] == 255


def test_two_cameras_that_see_nothing_in_common_are_no_pair(tmp_path: Path) -> None:
    opened = open_leniently(noise_of(tmp_path, "drone", 2, (400, 400)))
    report = inspect(opened)
    assert report.pair is None and report.stereo is None and "--mode" not in report.command
    assert not any(found.level == "error" for found in report.findings)
    assert report.calibration is not None
    assert [round(m.turned_deg) for m in report.calibration.mounts] == [0, 180]
    write_contact_sheet(tmp_path / "sheet.png", opened)
    sheet = cv2.imread(str(tmp_path / "sheet.png"), cv2.IMREAD_GRAYSCALE)
    assert sheet is not None
    rig = sheet[-640:, :640]
    assert rig[40, 320] == rig[600, 320] < 255 and rig[320, 40] == 255
