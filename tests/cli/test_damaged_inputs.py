"""Kinds of damage that ended in a traceback, by the commands that people type."""

from __future__ import annotations

import contextlib
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from vo.cli.app import app
from vo.recordings.formats.ros_reading import ros2_codec

VO = Path(sys.executable).with_name("vo")
_IMAGE = """\
std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_PARTS = f"""\
{"=" * 80}
MSG: x/msg/Part
x/Inner[1000] a
{"=" * 80}
MSG: x/msg/Inner
string[1000] b
"""


def run(folder: Path, *words: str) -> tuple[int, str]:
    with contextlib.chdir(folder):
        done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code in (0, 1)
    return done.exit_code, done.stdout + done.stderr


def run_alone(folder: Path, *words: str) -> tuple[int, str]:
    """In a process of its own, whose stack may overflow."""
    done = subprocess.run([VO, *words], cwd=folder, capture_output=True, check=False, timeout=120)
    text = (done.stdout + done.stderr).decode(errors="replace")
    assert "Traceback" not in text
    return done.returncode, text


def images(folder: Path, width: int = 64, height: int = 48) -> Path:
    folder.mkdir()
    (folder / "calibration.yaml").write_text(
        f"cam0: {{resolution: [{width}, {height}], intrinsics: [50, 50, 32, 24]}}\n", "utf-8"
    )
    for number in range(4):
        image = np.random.default_rng(number).integers(0, 255, (height, width), np.uint8)
        cv2.imwrite(str(folder / f"{number}.png"), image)
    return folder


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (2, 2)])
@pytest.mark.parametrize("command", ["info", "run", "convert", "calibrate"])
def test_tiny_images(command: str, size: tuple[int, int], tmp_path: Path) -> None:
    images(tmp_path / "images", *size)
    more = {"run": ["-o", "out"], "convert": ["converted"]}.get(command, [])
    assert run(tmp_path, command, "images", *more)[1]


CONTENTS = {
    "a date": "cam0: {resolution: [64, 48], intrinsics: [1, 2, 2001-99-99, 4]}\nt: 2001-99-99\n",
    "deep brackets": "cam0: " + "[" * 100_000,
    "deep braces": "{a: " * 20_000,
    "deep JSON": '{"cam0": ' * 20_000,
    "deep lines": "".join(" " * depth + "a:\n" for depth in range(600)),
    "deep XML": '<?xml version="1.0"?><opencv_storage>' + "<a>" * 50_000,
    "a long number": f"cam0: {{intrinsics: [1, 2, 0x{'f' * 9000}, 4]}}\n",
    "a long date": f"cam0: {{intrinsics: [1, 2, {':'.join('1' * 30_000)}, 4]}}\n",
    "a NUL": "cam0:\0 {}",
    "not UTF-8": b"cam0: {resolution: [64, 48]} # \xe9\xff\n",
    "half a character": '{"cam0": {"resolution": ["\\ud800", 1]}}',
}


@pytest.mark.parametrize("content", CONTENTS.values(), ids=CONTENTS)
def test_settings_and_calibrations(content: str | bytes, tmp_path: Path) -> None:
    images(tmp_path / "images")
    data = content if isinstance(content, bytes) else content.encode()
    (tmp_path / "a.yaml").write_bytes(data)
    for option in ("--config", "--calibration"):
        status, text = run_alone(tmp_path, "run", "images", option, "a.yaml", "-o", "out")
        assert status == 1
        line = text.splitlines()[-1]  # after a warning about stamps
        assert line.startswith("error: ") and "a.yaml" in line and len(line) < 600


@pytest.mark.parametrize(
    "row",
    [
        "2001-99-99 0 0 0 0 0 0 1",
        "9" * 9000 + " 0 0 0 0 0 0 1",
        "1e9999999 0 0 0 0 0 0 1",
        "0 0 \0 0",
    ],
    ids=["a date", "a long number", "a large number", "a NUL"],
)
def test_trajectories(row: str, tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text(f"{row}\n" * 5, encoding="utf-8")
    status, text = run(tmp_path, "eval", "a.tum", "a.tum")
    assert status == 1
    (line,) = text.splitlines()
    assert line.startswith("error: a.tum") and len(line) < 600


def test_metadata_of_a_video_that_is_not_utf8(tmp_path: Path) -> None:
    file = tmp_path / "v.mp4"
    with av.open(str(file), "w") as container:
        container.metadata["title"] = "ééé"
        stream = container.add_stream("mpeg4", 10)
        stream.width, stream.height = 64, 48
        for grey in range(10):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 9 * grey, np.uint8))
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    data = file.read_bytes()
    assert "ééé".encode() in data
    file.write_bytes(data.replace("ééé".encode(), b"\xe9" * 6))
    assert "10 images" in run(tmp_path, "info", "v.mp4")[1]


@pytest.mark.parametrize("value", [None, 5, b"\xff\xfe", ""])
@pytest.mark.parametrize("column", ["name", "type", "serialization_format", "id"])
def test_values_of_topics(column: str, value: object, tmp_path: Path) -> None:
    database = sqlite3.connect(tmp_path / "a.db3")
    database.executescript(
        "CREATE TABLE topics(id, name TEXT, type TEXT, serialization_format TEXT);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data);"
        "INSERT INTO topics VALUES (1, '/a', 'sensor_msgs/msg/Image', 'cdr');"
        "INSERT INTO topics VALUES (2, '/b', 'sensor_msgs/msg/Image', 'cdr');"
        "INSERT INTO messages VALUES (1, 1, 1, x'00'), (2, NULL, NULL, NULL), (3, 2, 'x', 'y');"
    )
    database.execute(f"UPDATE topics SET {column} = ? WHERE name = '/a'", (value,))
    database.commit()
    database.close()
    assert run(tmp_path, "info", "a.db3")[0] == 1


@pytest.mark.parametrize(
    "first",
    [
        "string[4000000000] junk",
        "uint8[4000000000] junk",
        "std_msgs/Header[40000000] junk",
        f"uint8[{'9' * 5000}] junk",
        "x/Part[1000] junk",
        "sensor_msgs/Image junk",
        f"int32 A={'(' * 5000}",
        "[" * 5000,
    ],
    ids=lambda text: text[:20],
)
def test_huge_numbers_in_the_definition_of_a_message(first: str) -> None:
    codec = ros2_codec("sensor_msgs/msg/Image", "ros2msg", f"{first}\n{_IMAGE}{_PARTS}".encode())
    assert codec is not None
    with pytest.raises(Exception, match="cannot be decoded"):
        codec.decode(b"\0\1\0\0" + b"\1\0\0\0" * 100)


@pytest.mark.parametrize(
    "change", [lambda data: b"", lambda data: data[:100], lambda data: data[::-1]]
)
def test_recordings_of_runs(change: Callable[[bytes], bytes], tmp_path: Path) -> None:
    (tmp_path / "run.rrd").write_bytes(change(b"RRF2" + bytes(range(200))))
    assert run(tmp_path, "view", "run.rrd")[0] == 1
