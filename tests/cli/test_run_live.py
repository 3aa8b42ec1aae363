"""`vo run` on a camera of this machine, with a stand-in for it, and on a stream until Ctrl-C."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from live_devices import FakeCapture
from live_servers import served
from run_calls import CALIBRATION, HEIGHT, VO, WIDTH, summary_in, vo_run

REFUSED = "cannot be opened: there is no such camera, another program uses it, or this user may not"


class NoiseCapture(FakeCapture):
    """Gives noise of the size that is asked for."""

    def __init__(self, target: object, *_: object) -> None:
        super().__init__(target, sizes=((WIDTH, HEIGHT), (2 * WIDTH, HEIGHT)))

    def read(self) -> tuple[bool, np.ndarray | None]:
        time.sleep(0.01)
        self._number += 1
        noise = np.random.default_rng([self._number % 7, str(self.target) == "1"])
        return True, noise.integers(0, 256, (self.size[1], self.size[0], 3), dtype=np.uint8)


@pytest.fixture
def camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A camera, number 0, and the file of its calibration."""
    monkeypatch.setattr(cv2, "VideoCapture", NoiseCapture)
    path = tmp_path / "camera.yaml"
    path.write_text(CALIBRATION.format(fx=80.0), encoding="utf-8")
    return path


@pytest.fixture
def stereo(camera: Path) -> Path:
    text = camera.read_text(encoding="utf-8")
    camera.write_text(text + "baseline_m: 0.1\n", encoding="utf-8")
    return camera


@pytest.mark.parametrize("source", ["camera:0", "/dev/video0", "camera:/dev/video0"])
def test_a_camera_is_tracked(source: str, camera: Path, out: Path) -> None:
    result = vo_run(source, out, "--calibration", camera, "--end", 8)
    assert result.exit_code in (0, 3), result.output
    summary = summary_in(out)
    assert (summary["format"], summary["mode"], summary["frames"]) == ("live", "mono", 8)
    assert summary["source"] == ("camera:0" if source == "camera:0" else "camera:/dev/video0")
    assert "delay" in result.output


def test_two_cameras_or_two_halves_are_a_pair(stereo: Path, out: Path, tmp_path: Path) -> None:
    for source, more in (("camera:0,1", ()), ("camera:0", ("--side-by-side",))):
        result = vo_run(source, out, "--calibration", stereo, "--end", 4, *more)
        assert result.exit_code in (0, 3), result.output
        assert summary_in(out)["mode"] == "stereo"
        assert ("nothing synchronises two devices" in result.output) == (not more)
    log = tmp_path / "log.mcap"
    vo_run("camera:0,1", out, "--calibration", stereo, "--end", 4, "--record", log)
    assert summary_in(out)["live"]["unrecorded"] == 0
    vo_run(log, out)
    assert (summary_in(out)["frames"], summary_in(out)["mode"]) == (4, "stereo")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["camera:0"], "error: camera:0: a live camera needs --calibration FILE"),
        (["camera:x"], "error: camera 'x' is neither a number nor a device file"),
        (["camera:9", "--calibration", "{}"], f"error: camera:9 {REFUSED}"),
        (["camera:0,9", "--calibration", "{}"], f"error: camera:9 {REFUSED}"),
        (["camera:0", "--calibration", "{}", "--record", "x.bag"], "needs a name that ends in"),
        (["camera:0", "--calibration", "{}", "--follow"], "--follow is for recordings"),
        (["realsense:"], "RealSense cameras need the extra 'realsense': pip install"),
    ],
)
def test_what_cannot_work_is_one_line(
    arguments: list[str], message: str, camera: Path, out: Path
) -> None:
    source, *options = (argument.format(camera) for argument in arguments)
    result = vo_run(Path(source), out, *options)
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())
    assert not out.exists()


def test_a_recording_takes_no_options_of_live_sources(images: Path, out: Path) -> None:
    result = vo_run(images, out, "--record", out / "log.mcap")
    assert result.exit_code == 1
    assert "--record is for live sources" in result.output


@pytest.fixture
def stream() -> Iterator[str]:
    noise = np.random.default_rng(0).integers(0, 256, (5, HEIGHT, WIDTH), dtype=np.uint8)
    with served("http", list(noise), 25.0) as server:
        yield server.url


def test_ctrl_c_ends_a_live_run_as_if_it_were_finished(
    stream: str, camera: Path, out: Path
) -> None:
    command = [VO, "run", stream, "-o", out, "--calibration", camera, "--record", out / "log.mcap"]
    process = subprocess.Popen(list(map(str, command)), stdout=subprocess.PIPE, text=True)
    give_up = time.monotonic() + 60.0
    while not (out / "causal.tum.partial").exists() or summary_frames(out) < 1:
        assert process.poll() is None
        assert time.monotonic() < give_up
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    printed, _ = process.communicate(timeout=60.0)
    assert process.returncode in (0, 3)
    assert "frames" in printed
    summary = summary_in(out)
    assert summary["status"] == "finished"
    assert not list(out.glob("*.partial"))
    again = vo_run(out / "log.mcap", out.parent / "again")
    assert again.exit_code in (0, 3), again.output
    assert summary_in(out.parent / "again")["frames"] == summary["frames"]


def summary_frames(out: Path) -> int:
    try:
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return 0
    return int(summary["frames"])
