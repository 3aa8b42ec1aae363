"""Small files that stand for gigabytes, and endless ones, end with a line and take no memory."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import bombs
import cv2
import numpy as np
import pytest

VO = Path(sys.executable).with_name("vo")
_MAX_RSS_MB = 500  # `vo` itself takes 150 to 300
_CALIBRATION = """\
cam0: {resolution: [64, 48], intrinsics: [60, 60, 32, 24]}
"""


class Outcome(NamedTuple):
    """Exit status, everything printed, and peak memory of a command."""

    status: int
    text: str
    rss_mb: float


# The peak of a process counts that of the one that forked it: pytest has more than the limit.
_MEASURED = """
import resource, subprocess, sys
resource.setrlimit(resource.RLIMIT_AS, (4 * 2**30, 4 * 2**30))
status = subprocess.run(sys.argv[1:], stdin=subprocess.DEVNULL).returncode
print()
print(status, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def run(*words: object) -> Outcome:
    """Run a command of `vo` in a process of its own that can have 4 GB."""
    command = [sys.executable, "-c", _MEASURED, VO, *map(str, words)]
    output = subprocess.run(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, "PYTHONFAULTHANDLER": "1"},
        check=True,
    ).stdout.decode()
    text, _, measured = output.rstrip("\n").rpartition("\n")
    status, peak_kb = map(int, measured.split())
    return Outcome(status, text, peak_kb / 1024)


def assert_refused(outcome: Outcome, words: str) -> None:
    assert "Traceback" not in outcome.text
    assert words in " ".join(outcome.text.split())
    assert outcome.status == 1
    assert outcome.rss_mb < _MAX_RSS_MB


def folder_of(path: Path, *images: bytes) -> Path:
    """A recording of image files."""
    path.mkdir()
    (path / "calibration.yaml").write_text(_CALIBRATION, encoding="utf-8")
    for number, data in enumerate(images):
        (path / f"{number}.png").write_bytes(data)
    return path


def small() -> bytes:
    return cv2.imencode(".png", np.zeros((48, 64), np.uint8))[1].tobytes()


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_chunk_of_a_ros1_bag(compression: str, tmp_path: Path) -> None:
    bombs.bag1(tmp_path / "a.bag", compression)
    outcome = run("info", tmp_path / "a.bag")
    assert_refused(outcome, "it unpacks to more than the stated 1000 bytes")


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("stated", [1000, 2**31])
def test_chunk_of_an_mcap_file(compression: str, stated: int, tmp_path: Path) -> None:
    bombs.mcap(tmp_path / "a.mcap", compression, stated)
    assert_refused(run("info", tmp_path / "a.mcap"), "")


@pytest.mark.parametrize("mode", ["message", "file"])
def test_zstd_in_a_ros2_bag(mode: str, tmp_path: Path) -> None:
    bombs.bag2(tmp_path / "bag", mode)
    assert_refused(run("info", tmp_path / "bag"), "")


@pytest.mark.parametrize("view", bombs.VIEWS)
def test_sqlite_that_computes(view: str, tmp_path: Path) -> None:
    bombs.database(tmp_path / "a.db3", bombs.VIEWS[view])
    assert_refused(run("info", tmp_path / "a.db3"), "is not a plain table")


@pytest.mark.parametrize("size", [(60_000, 60_000), (30_000, 30_000)])
@pytest.mark.parametrize("colour", [0, 2])
def test_png_of_a_huge_size(size: tuple[int, int], colour: int, tmp_path: Path) -> None:
    image = bombs.png(*size, colour)
    outcome = run("info", folder_of(tmp_path / "folder", image, image))
    assert_refused(outcome, f"has {size[0]}x{size[1]} pixels; at most 134217728 are decoded")


@pytest.mark.parametrize("text", [bombs.alias_yaml(), bombs.merge_yaml()])
def test_yaml_that_expands(text: str, tmp_path: Path) -> None:
    file = tmp_path / "bomb.yaml"
    file.write_text(text, encoding="utf-8")
    folder = folder_of(tmp_path / "folder", small(), small())
    words = "aliases expand to more than 200000 values"
    assert_refused(run("run", folder, "--calibration", file, "-o", tmp_path / "out"), words)
    assert_refused(run("run", folder, "--config", file, "-o", tmp_path / "out"), words)


def test_yaml_that_contains_itself(tmp_path: Path) -> None:
    file = tmp_path / "bomb.yaml"
    file.write_text("a: &a [1, *a]\n", encoding="utf-8")
    folder = folder_of(tmp_path / "folder", small(), small())
    outcome = run("run", folder, "--config", file, "-o", tmp_path / "out")
    assert_refused(outcome, "an alias refers to what contains it")


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(8 * 2**30)


def _endless_line(path: Path) -> None:
    path.write_bytes(b"1 " * 50_000_000)


ENDLESS = {"pipe": _pipe, "device": _device, "sparse file": _sparse, "line": _endless_line}


@pytest.mark.parametrize("make", ENDLESS.values(), ids=ENDLESS)
def test_endless_files(make: Callable[[Path], None], tmp_path: Path) -> None:
    endless = tmp_path / "endless.txt"
    make(endless)
    folder = folder_of(tmp_path / "folder", small(), small())
    assert_refused(run("eval", endless, endless), "error: ")
    assert_refused(run("run", folder, "--calibration", endless, "-o", tmp_path / "o"), "error: ")
    assert_refused(run("run", folder, "--config", endless, "-o", tmp_path / "o"), "error: ")
    (folder / "times.txt").symlink_to(endless)
    assert_refused(run("run", folder, "-o", tmp_path / "o"), "error: ")
    (folder / "summary.json").symlink_to(endless)
    assert_refused(run("report", folder), "error: ")


@pytest.mark.parametrize("make", [_pipe, _device, _sparse], ids=["pipe", "device", "sparse file"])
def test_endless_images(make: Callable[[Path], None], tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "folder", small(), small(), small())
    (folder / "rgb.txt").write_text("0 0.png\n1 9.png\n2 2.png\n", encoding="utf-8")
    make(folder / "9.png")
    outcome = run(
        *("run", folder, "--calibration", folder / "calibration.yaml"),
        *("-o", tmp_path / "out", "--threads", 1),
    )
    assert "Traceback" not in outcome.text and outcome.rss_mb < _MAX_RSS_MB
    assert "9.png cannot be read: it " in " ".join(outcome.text.split())


@pytest.mark.parametrize("lines", ["ffconcat version 1.0\nfile {}\n", "#EXTM3U\n#EXTINF:1,\n{}\n"])
def test_playlists_of_other_videos(lines: str, tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for grey in range(20):
        writer.write(np.full((48, 64, 3), grey, np.uint8))
    writer.release()
    assert "20 images" in run("info", tmp_path / "v.avi").text
    (tmp_path / "list.mp4").write_text(lines.format("v.avi"), encoding="utf-8")
    assert_refused(run("info", tmp_path / "list.mp4"), "list.mp4 ")


@pytest.mark.parametrize("name", ["http:v.avi", "concat:a|v.avi", "pipe:0.avi", "-v.avi"])
def test_video_with_the_name_of_an_address(name: str, tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for grey in range(20):
        writer.write(np.full((48, 64, 3), grey, np.uint8))
    writer.release()
    (tmp_path / "v.avi").rename(tmp_path / name)
    done = subprocess.run(
        [VO, "info", "--", name], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert "20 images" in done.stdout
