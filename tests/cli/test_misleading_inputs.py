"""Files that say one thing and are another: `vo info`, then exactly what it proposes.

The files, with a README each, are not part of the project; each kind has tests of its own beside
its reader.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from vo.cli.app import app

CASES = Path(__file__).parents[2] / ".." / "shared" / "cases" / "files"
FOCAL = r"focal length 160\.0, 160\.0 px"
EXACT = r"ATE, translation +m +0\.00000"


class Row(NamedTuple):
    """A command in the folder of a case.

    Attributes:
        case: number of the folder.
        expected: what is found in the output.
        code: exit status.
        result: what is found in that of the command which `vo info` proposes; empty if it proposes
            none.
    """

    case: str
    command: str
    expected: str
    code: int = 0
    result: str = ""


ALL = r"result +(complete|not to be trusted).*all {} frames have a pose".format
STILL = r"result +no path(?s:.*)hardly moves"
SMALL = STILL.replace("hardly moves", "very small")
LFS = r"is a Git LFS pointer, not the file: git lfs pull"
ROWS = [
    Row("01", "info humble.db3", r"baseline 0\.1101 m", 0, ALL(3)),
    Row("02", "info nodisplay.mp4", r"24 images.*10 Hz.*no gaps", 0, ALL(24)),
    Row("03", "eval perfect_estimate.tum . --align se3", EXACT),
    Row("04", "info images --calibration python_tutorial.yaml", "distortion radtan", 0, SMALL),
    Row("05", "eval estimate.tum poses.bag", EXACT),
    Row("05", "eval poses.bag estimate.tum", EXACT),
    Row("06", "info poses.bag", r"problem: no topic has images of a known type; topics: \w", 1),
    Row(
        "07",
        "info {pair} --calibration kalibr_imucam_chain.yaml",
        r"baseline 0\.11 m, rectified",
        0,
        ALL(4),
    ),
    Row("08", "info {images} --calibration out_camera_data.yml", r"615\.2, 615\.4 px"),
    Row("08", "info {images} --calibration out_camera_data.xml", r"615\.2, 615\.4 px"),
    Row("09", "info images --calibration cameras.txt", "EXIF asks to turn 2 of 3", 0, STILL),
    *(Row("12", f"info {name}", LFS, 1) for name in ("log.mcap", "log.bag", "walk.mp4", "images")),
    Row("20", "info images --calibration camera.yaml", "25 images.*no gaps", 0, ALL(25)),
    Row("20", "info tum --calibration camera.yaml", "6 images.*no gaps", 0, STILL),
    Row("20", "eval estimate.tum truth.tum", EXACT),
    Row("21", "info images --calibration cameras.json", FOCAL, 0, ALL(25)),
    Row("22", "info images --calibration profile.json", "128° x 87°.*equidistant", 0, ALL(25)),
    Row("22", "info images --calibration profile_flags.json", "128° x 87°.*equidistant"),
    Row("23", "info garbage.mcap", r"problem: .*they must be \[0, fy, cy\] and \[0, 0, 1\]", 1),
    Row("23", "run garbage.mcap", r"\[0, 0, 1\]; give a file with --calibration FILE", 1),
    Row("24", "info both_have_it.mcap", "same last column.*baseline would be 0.12 m", 0, STILL),
    Row("24", "info centimetres.mcap", "if it is 0.12 m, given in centimetres", 1, STILL),
    Row("24", "run centimetres.mcap", "result +not to be trusted"),
    Row("25", "info rect.mcap", r"baseline 0\.12 m, rectified", 0, ALL(6)),
    Row("26", "info compressed_image_h264.mcap", f"30 images(?s:.*){FOCAL}", 0, ALL(30)),
    Row("26", "info ffmpeg_packet.mcap", f"30 images(?s:.*){FOCAL}", 0, ALL(30)),
    Row("26", "info compressed_image_nv12.mcap", "its message gives the format 'nv12'", 1),
    Row("27", "info step_of_a_pixel.mcap", "said to have 4 bytes.*read so", 0, STILL),
    Row("28", "info images --calibration camera.yaml", "stored in the wrong order", 0, ALL(10)),
    Row("29", "info viewer.bag", r"baseline 0\.12 m.*\n.*disparity 2\.9 px", 0, ALL(3)),
    Row("29", "info viewer_inverse.bag", r"baseline 0\.12 m, rectified", 0, ALL(3)),
    Row("30", "info raw.h264", "raw H.264 video.*`ffmpeg -framerate 30 -i raw.h264", 1),
    Row("30", "info raw.h264 --format video", "raw H.264 video", 1),
    Row("30", "info raw.mjpeg", "raw MJPEG video.*`ffmpeg -f mjpeg", 1),
    Row("30", "info images.zip", "`unzip images.zip -d images`", 1),
    Row("30", "info images.tar.gz", "`tar xf images.tar.gz`", 1),
    Row("30", "info events.aedat4", "event camera", 1),
    Row("30", "info rec.hdf5", "HDF5 file", 1),
    Row("30", "info rec.rrd", "rerun viewer", 1),
    Row("30", "info rec.vrs", "`vrs extract-images", 1),
    Row("31", "info walk.mp4 --calibration camera.yaml", "30 images", 0, ALL(30)),
    Row(
        "31",
        "run walk.mp4 --calibration camera.yaml --mode mono --scale-from walk.SRT",
        r"scale +[\d.]+ m per map unit",
    ),
    Row(
        "31",
        "run walk.mp4 --calibration camera.yaml --mode mono --scale-from walk.gpx",
        "difference by --scale-offset",
        1,
    ),
    Row(
        "32",
        "info depth_first.mkv --calibration camera.yaml",
        r"2 video tracks: 0 \(DEPTH, gray16le\), 1 \(COLOR, yuvj420p\); track 1 is used",
        0,
        "result +no path",
    ),
    Row("33", "info images --calibration camera_utf16.yaml", FOCAL, 0, STILL),
    Row("34", "info yuv422_with_yuyv.mcap", "not as stated.*yuv422_yuy2", 0, STILL),
]


def vo(*words: str) -> tuple[int, str]:
    """Exit status and all output of a command; a traceback is an error of the test."""
    result = CliRunner().invoke(app, list(words))
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, " ".join(result.output.split("\n  ")).replace("\n ", "\n")


def write_noise(folder: Path, width: int, height: int, *, is_pair: bool) -> Path:
    noise = np.random.default_rng(0).integers(0, 256, (height, width + 40), np.uint8)
    wide = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)
    for number in range(4):
        for side, shift in (("left", 0), ("right", 4)) if is_pair else (("", 0),):
            (folder / side).mkdir(parents=True, exist_ok=True)
            start = 3 * number + shift
            cv2.imwrite(str(folder / side / f"{number}.png"), wide[:, start : start + width])
    return folder


@pytest.mark.parametrize("row", ROWS, ids=[f"{row.case} {row.command}" for row in ROWS])
def test_command_and_what_it_proposes(
    row: Row, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = sorted(CASES.glob(f"{row.case}-*"))
    if not folders:
        pytest.skip("the files are not in ../shared/cases/files")
    monkeypatch.chdir(folders[0])
    monkeypatch.setenv("COLUMNS", "4000")
    pair, images = tmp_path / "pair", tmp_path / "images"
    if "{pair}" in row.command:
        write_noise(pair, 160, 120, is_pair=True)
    elif "{images}" in row.command:
        write_noise(images, 640, 480, is_pair=False)
    words = shlex.split(row.command.format(pair=pair, images=images))
    if words[0] == "run":
        words += ["-o", str(tmp_path / "out")]
    code, output = vo(*words)
    assert re.search(row.expected, output), output
    assert code == row.code
    proposed = re.findall(r"^try: vo (.*)", output, re.MULTILINE)
    needs_a_file = [each for each in proposed if each.endswith("--calibration camera.yaml")]
    assert len(proposed) == (code == 0 and words[0] == "info") or row.result or needs_a_file
    if row.result:
        words = shlex.split(*proposed)
        words[words.index("-o") + 1] = str(tmp_path / "proposed")
        code, output = vo(*words)
        assert re.search(row.result, output), output
        assert code in (0, 3)


def test_each_case_has_a_row() -> None:
    assert {path.name[:2] for path in CASES.glob("[0-9][0-9]-*")} <= {row.case for row in ROWS}
