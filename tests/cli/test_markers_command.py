"""`vo markers` from the command line."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from marker_views import Placed, developed, looking_at, random_background, render
from typer.testing import CliRunner

import vo
from vo.base.types import Camera, Rig
from vo.cli.app import app
from vo.tools.markers.detection import MarkerDetector

CAMERA = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)


def _image(path: Path, *numbers: int, distance: float = 1.0, tilt: float = 0.4) -> Path:
    rng = np.random.default_rng(0)
    levels = random_background(rng, (480, 640)).astype(np.float64)
    for n, number in enumerate(numbers):
        pose = looking_at(np.array([0.25 * n - 0.1, 0.0, distance]), tilt, 1.0, 0.0)
        levels = render(CAMERA, Placed("4X4_50", number, 0.16, pose), levels.astype(np.uint8))
    cv2.imwrite(str(path), developed(levels, rng))
    return path


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    path = tmp_path / "camera.yaml"
    vo.write_calibration(path, Rig(CAMERA))
    return path


def test_an_image_gives_poses_a_picture_and_rows(tmp_path: Path, calibration: Path) -> None:
    image = _image(tmp_path / "a.png", 3, 9)
    picture, table = tmp_path / "found.png", tmp_path / "found.csv"
    words = ["markers", str(image), "--length", "0.16", "--calibration", str(calibration)]
    words += ["--json", "--picture", str(picture), "--csv", str(table)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["dictionary"] == "4X4_50"
    markers = found["frames"][0]["markers"]
    assert [marker["id"] for marker in markers] == [3, 9]
    position = np.array(markers[0]["pose"]["cam_from_marker"])[:3, 3]
    np.testing.assert_allclose(position, [-0.1, 0.0, 1.0], atol=1e-3)
    assert cv2.imread(str(picture)).shape == (480, 640, 3)
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert [row["id"] for row in rows] == ["3", "9"]
    assert float(rows[1]["tz"]) == pytest.approx(1.0, abs=1e-3)
    text = CliRunner().invoke(app, words[:6])
    assert "dictionary 4X4_50" in " ".join(text.stdout.split())
    assert "clear" in text.stdout


def test_a_recording_gives_one_line_for_each_id(tmp_path: Path, calibration: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for n in range(3):
        _image(folder / f"{n:03d}.png", 3, distance=1.0 + 0.1 * n)
    words = ["markers", str(folder), "--length", "0.16", "--calibration", str(calibration)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "3 views in 3 of 3 frames" in result.stdout
    assert "1.00 to 1.20" in result.stdout


def test_without_calibration_there_are_ids_but_no_poses(tmp_path: Path) -> None:
    image = _image(tmp_path / "a.png", 3)
    result = CliRunner().invoke(app, ["markers", str(image), "--length", "0.16", "--json"])
    assert result.exit_code == 0
    (marker,) = json.loads(result.stdout)["frames"][0]["markers"]
    assert marker["pose"] is None and marker["id"] == 3
    assert "has no calibration: ids and corners are found, but no poses" in result.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--length", "160"], "metres, not millimetres: 0.16"),
        (["--dictionary", "DICT_9X9"], "unknown --dictionary 'DICT_9X9'"),
        (["--board", "grid"], "--board grid needs --length"),
        (["--picture", "a.gif"], "must end in .png"),
    ],
)
def test_bad_options_are_one_clear_line(tmp_path: Path, words: list[str], message: str) -> None:
    image = _image(tmp_path / "a.png", 3)
    result = CliRunner().invoke(app, ["markers", str(image), *words])
    assert result.exit_code == 1
    (line,) = [each for each in result.stderr.splitlines() if each.startswith("error:")]
    assert message in line


def test_two_markers_of_one_id_and_small_ones_are_told(tmp_path: Path) -> None:
    image = _image(tmp_path / "a.png", 3, 3)
    result = CliRunner().invoke(app, ["markers", str(image)])
    assert "marker 3 is seen more than once in frame 0" in " ".join(result.stderr.split())
    far = _image(tmp_path / "far.png", 3, distance=10.5, tilt=0.1)
    result = CliRunner().invoke(app, ["markers", str(far), "--dictionary", "4X4_50"])
    assert result.exit_code == 1
    assert "marker 3 of 4X4_50 is too small" in " ".join(result.stderr.split())


def test_a_printed_sheet_has_the_size_it_says(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    sheet = tmp_path / "sheet.png"
    words = ["markers", "--print", str(sheet), "--length", "0.05", "--ids", "0-2"]
    result = CliRunner().invoke(app, [*words, "--dictionary", "tag36h11"])
    assert result.exit_code == 0, result.output
    image = cv2.imread(str(sheet), cv2.IMREAD_GRAYSCALE)
    markers = vo.find_markers(image, dictionary="tag36h11")
    assert [marker.id for marker in markers] == [0, 1, 2]
    for marker in markers:
        assert marker.detected.side_px == pytest.approx(0.05 / 0.0254 * 300, rel=0.01)
    again = CliRunner().invoke(app, words)
    assert again.exit_code == 1 and "exists already" in again.stderr
    assert CliRunner().invoke(app, [*words, "--force"]).exit_code == 0
    sheet.unlink()
    missing = CliRunner().invoke(app, ["markers", "--print", str(sheet)])
    assert "--print needs --length" in missing.stderr


@pytest.mark.parametrize(
    ("kind", "dictionary", "gap"),
    [
        ("grid", "4X4_50", "0.01"),
        ("charuco", "4X4_50", "0.01"),
        ("grid", "tagStandard41h12", "0.03"),
    ],
)
def test_a_printed_board_is_the_one_that_is_found(
    kind: str, dictionary: str, gap: str, tmp_path: Path, calibration: Path
) -> None:
    pytest.importorskip("matplotlib")
    sheet = tmp_path / "board.png"
    board = ["--board", kind, "--columns", "4", "--rows", "3", "--dictionary", dictionary]
    board += ["--length", "0.03", "--gap", gap, "--square", "0.04"]
    result = CliRunner().invoke(app, ["markers", "--print", str(sheet), *board])
    assert result.exit_code == 0, result.output
    assert kind in result.stderr and "4 x 3" in result.stderr
    image = cv2.imread(str(sheet), cv2.IMREAD_GRAYSCALE)
    focal = 1.5 * image.shape[1]
    centre = (0.5 * image.shape[1] - 0.5, 0.5 * image.shape[0] - 0.5)
    camera = Camera(image.shape[1], image.shape[0], focal, focal, *centre)
    vo.write_calibration(calibration, Rig(camera))
    words = ["markers", str(sheet), *board, "--calibration", str(calibration), "--json"]
    found = CliRunner().invoke(app, words)
    assert found.exit_code == 0, found.output
    (frame,) = json.loads(found.stdout)["frames"]
    assert len(frame["markers"]) == (12 if kind == "grid" else 10)
    pose = np.array(frame["board"]["cam_from_marker"])
    assert pose[2, 3] == pytest.approx(focal * 0.0254 / 300, rel=5e-3)
    words = ["markers", "--print", str(sheet), *board, "--ids", "3", "--force"]
    refused = CliRunner().invoke(app, words)
    assert refused.exit_code == 1 and "a board has those from 0 on" in refused.stderr


def test_the_library_finds_the_same(calibration: Path, tmp_path: Path) -> None:
    image = cv2.imread(str(_image(tmp_path / "a.png", 3)))
    (marker,) = vo.find_markers(image, 0.16, calibration=str(calibration))
    assert marker.pose is not None
    assert marker.pose.distance_m == pytest.approx(np.hypot(0.1, 1.0), abs=1e-3)
    with pytest.raises(vo.CalibrationError, match="320 x 240"):
        vo.find_markers(np.zeros((240, 320), np.uint8), 0.16, calibration=CAMERA)


def test_small_markers_are_found_in_double_size(tmp_path: Path) -> None:
    """Sides of 12 to 15 pixels, of which the image as it is shows few."""
    name, found, alone = "APRILTAG_36H11", 0, 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        levels = random_background(rng, (480, 640)).astype(np.float64)
        for n in range(4):
            distance = 600.0 * 0.16 / rng.uniform(12.0, 15.0)
            place = np.array([0.35 * n - 0.5, 0.3 * (n % 2) - 0.15, 1.0]) * distance
            place[2] = distance
            pose = looking_at(place, rng.uniform(0.0, 0.5), rng.uniform(0.0, 6.0), 0.1)
            levels = render(CAMERA, Placed(name, n, 0.16, pose), levels.astype(np.uint8))
        image = developed(levels, rng)
        found += sum(each.id < 4 for each in vo.find_markers(image, dictionary="tag36h11"))
        alone += len(MarkerDetector(name).detect(image))
        assert all(each.id < 4 for each in vo.find_markers(image, dictionary="tag36h11"))
        if seed == 0:
            assert {each.id for each in vo.find_markers(image)} <= set(range(4))
    assert found >= 14 and alone <= 6, (found, alone)


def test_a_body_of_markers_has_one_pose(tmp_path: Path, calibration: Path) -> None:
    """A cube of 0.2 m, of which the camera sees the sides +z (id 0) and +x (id 1)."""
    body = tmp_path / "cube.yaml"
    body.write_text(
        "length_m: 0.16\ndictionary: 4X4_50\nmarkers:\n"
        "  - {id: 0, position: [0, 0, 0.1], quat_xyzw: [0, 0, 0, 1]}\n"
        "  - {id: 1, position: [0.1, 0, 0], quat_xyzw: [0, 0.70710678, 0, 0.70710678]}\n",
        encoding="utf-8",
    )
    cam_from_body = looking_at(np.array([0.05, 0.02, 1.0]), 0.7, -1.5708, 0.0)
    rng = np.random.default_rng(2)
    levels = random_background(rng, (480, 640)).astype(np.float64)
    front, side = np.eye(4), np.eye(4)
    front[2, 3], side[0, 3] = 0.1, 0.1
    side[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    for number, at in ((0, front), (1, side)):
        placed = Placed("4X4_50", number, 0.16, cam_from_body @ at)
        levels = render(CAMERA, placed, levels.astype(np.uint8))
    image = tmp_path / "cube.png"
    cv2.imwrite(str(image), developed(levels, rng))
    words = ["markers", str(image), "--body", str(body), "--calibration", str(calibration)]
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0, result.output
    frame = json.loads(result.stdout)["frames"][0]
    seen = [marker["id"] for marker in frame["markers"]]
    pose = np.array(frame["board"]["cam_from_marker"])
    assert seen == [0, 1], seen
    np.testing.assert_allclose(pose[:3, 3], cam_from_body[:3, 3], atol=2e-3)
    np.testing.assert_allclose(pose[:3, :3], cam_from_body[:3, :3], atol=0.01)
    refused = CliRunner().invoke(app, [*words, "--board", "grid"])
    assert "exclude each other" in refused.stderr


def test_a_recording_is_drawn_as_a_video(tmp_path: Path, calibration: Path) -> None:
    folder, video = tmp_path / "images", tmp_path / "found.mp4"
    folder.mkdir()
    for n in range(3):
        _image(folder / f"{n:03d}.png", 3, distance=1.0 + 0.1 * n)
    words = ["markers", str(folder), "--length", "0.16", "--calibration", str(calibration)]
    result = CliRunner().invoke(app, [*words, "--video", str(video)])
    assert result.exit_code == 0, result.output
    read = cv2.VideoCapture(str(video))
    assert int(read.get(cv2.CAP_PROP_FRAME_COUNT)) == 3
    picture = read.read()[1].astype(int)
    read.release()
    assert (picture.max(axis=2) - picture.min(axis=2) > 60).sum() > 200  # coloured lines
    for target, message in ((folder / "000.png", "of a recording"), (folder, "must end in")):
        name = str(video) if target.is_file() else "found.gif"
        refused = CliRunner().invoke(app, ["markers", str(target), "--video", name])
        assert refused.exit_code == 1 and message in refused.stderr
