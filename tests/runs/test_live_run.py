"""Runs on live sources: drops, delays, gaps, and how they end."""

from __future__ import annotations

import json
import os
import signal
import socket
import time
from contextlib import closing
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from live_servers import served

from vo.base.config import load_config
from vo.base.errors import CalibrationError, ConfigError, OutputError, SourceError
from vo.base.types import Camera, Estimate, Rig
from vo.outputs.streaming.json_lines import JsonLines
from vo.recordings.formats.calibration import write_calibration
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

FAST = load_config("fast")
RATE_HZ = 25.0


class Walk(NamedTuple):
    """A walk to and fro: images of the left camera, or both beside each other."""

    left: list[np.ndarray]
    both: list[np.ndarray]
    mono: Path
    stereo: Path


@pytest.fixture(scope="module")
def walk(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Walk:
    recording = open_source(synthetic_stereo)
    frames = [frame.images for frame in islice(recording.frames(), 20)]
    height, width = (size // 16 * 16 for size in np.shape(frames[0][0]))
    cut = [tuple(np.asarray(image)[:height, :width] for image in pair) for pair in frames]
    cut += cut[-2:0:-1]

    def cropped(camera: Camera) -> Camera:
        return replace(camera, width=width, height=height)

    folder = tmp_path_factory.mktemp("walk")
    rig = recording.rig
    assert rig.cam1 is not None
    write_calibration(folder / "mono.yaml", Rig(cropped(rig.cam0)))
    both = Rig(cropped(rig.cam0), cropped(rig.cam1), rig.cam1_from_cam0)
    write_calibration(folder / "stereo.yaml", both)
    return Walk(
        [left for left, _ in cut],
        [np.hstack(pair) for pair in cut],
        folder / "mono.yaml",
        folder / "stereo.yaml",
    )


class Consumer:
    """Takes `slow_s` for each of some frames, and notes when each pose was there."""

    def __init__(self, slow: range = range(0), slow_s: float = 0.0) -> None:
        self.at: list[float] = []
        self.estimates: list[Estimate] = []
        self._slow, self._slow_s = slow, slow_s

    def begin(self, name: str, total: int) -> None: ...

    def step(self, done: int, estimate: Estimate) -> None:
        self.estimates.append(estimate)
        self.at.append(time.time())
        if done in self._slow:
            time.sleep(self._slow_s)

    def finish(self) -> None: ...


def summary_in(folder: Path) -> dict[str, Any]:
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(summary, dict)
    return summary


@pytest.mark.parametrize("scheme", ["rtsp", "http"])
def test_a_stream_gives_a_pose_for_each_image(scheme: str, walk: Walk, tmp_path: Path) -> None:
    begun_ns = time.time_ns()
    with served(scheme, walk.both, RATE_HZ) as server:
        source = server.url.replace("//", "//me:secret@")
        summary = run(
            source, tmp_path, config=FAST, calibration=walk.stereo, side_by_side=True, end=40
        )
    assert (summary.status, summary.frames, summary.facts.mode) == ("finished", 40, "stereo")
    assert summary.tracked >= 38
    assert summary.facts.source == f"{scheme}://me:***@127.0.0.1:{server.port}/camera"
    path = read_tum(tmp_path / "causal.tum")
    assert begun_ns < path.stamps_ns[0] < path.stamps_ns[-1] < time.time_ns()
    for file in tmp_path.iterdir():
        assert "secret" not in file.read_text(encoding="utf-8")


def test_a_consumer_that_is_slow_for_a_while_loses_images_and_no_time(
    walk: Walk, tmp_path: Path
) -> None:
    """Images that come meanwhile are left out, counted and told; then poses are in time again."""
    consumer = Consumer(slow=range(10, 30), slow_s=0.15)
    with served("rtsp", walk.both, RATE_HZ) as server:
        summary = run(
            server.url,
            tmp_path,
            config=FAST,
            calibration=walk.stereo,
            side_by_side=True,
            end=50,
            progress=consumer,
        )
    live = summary_in(tmp_path)["live"]
    dropped = [estimate.dropped for estimate in consumer.estimates]
    assert dropped == sorted(dropped)
    assert live["dropped"] >= dropped[-1] >= 20
    delays_s = [
        at - 1e-9 * estimate.stamp_ns
        for at, estimate in zip(consumer.at, consumer.estimates, strict=True)
    ]
    assert np.median(delays_s[10:20]) < 0.5  # a queue would make it 0.6 s
    assert any("images of the camera dropped" in warning for warning in summary.warnings)
    assert live["delay_ms"]["median"] <= live["delay_ms"]["p95"] <= live["delay_ms"]["max"]
    assert [estimate.frame_index for estimate in consumer.estimates] == list(range(50))


def test_poses_are_sent_and_a_reader_that_stands_still_does_not_hold_up_the_run(
    walk: Walk, tmp_path: Path
) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    while True:
        try:
            os.write(writing, b"\n" * 4096)
        except BlockingIOError:
            break
    os.set_blocking(writing, True)
    with (
        closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as receiver,
        open(writing, "wb", buffering=0) as full,
        served("http", walk.both, RATE_HZ) as server,
    ):
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        poses = [f"udp://127.0.0.1:{receiver.getsockname()[1]}", JsonLines(full)]
        options = {"calibration": walk.stereo, "side_by_side": True, "end": 20}
        summary = run(server.url, tmp_path, config=FAST, poses=poses, **options)
        records = [json.loads(receiver.recv(65536)) for _ in range(20)]
    os.close(reading)
    assert (summary.status, summary.frames) == ("finished", 20)
    posed = [r["stamp_ns"] for r in records if r["world_from_cam0"] is not None]
    assert posed == read_tum(tmp_path / "causal.tum").stamps_ns.tolist()
    dropped = [record["dropped"] for record in records]
    assert dropped == sorted(dropped)
    assert dropped[-1] <= summary_in(tmp_path)["live"]["dropped"]


def test_a_gap_of_the_stream_gets_no_poses(walk: Walk, tmp_path: Path) -> None:
    class Cut(Consumer):
        def step(self, done: int, estimate: Estimate) -> None:
            super().step(done, estimate)
            if done == 15:
                server.cut_connections()

    consumer = Cut()
    with served("rtsp", walk.both, RATE_HZ) as server:
        summary = run(
            server.url,
            tmp_path,
            config=FAST,
            calibration=walk.stereo,
            side_by_side=True,
            end=40,
            progress=consumer,
        )
    assert summary.live is not None
    (gap,) = summary.live.gaps
    stamps = np.array([estimate.stamp_ns for estimate in consumer.estimates])
    assert not ((stamps > gap.first_ns) & (stamps < gap.last_ns)).any()
    assert gap.last_ns - gap.first_ns > 200_000_000
    assert any("connection lost once" in warning for warning in summary.warnings)


def test_a_stream_whose_images_change_size_ends_and_says_so(
    walk: Walk, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    smaller = [image[:-16] for image in walk.left[20:]]
    with served("http", walk.left[:20] + smaller, RATE_HZ) as server, pytest.raises(SourceError):
        run(server.url, tmp_path, config=FAST, calibration=walk.mono, mode="mono")
    found = summary_in(tmp_path)
    assert (found["status"], found["trusted"]) == ("failed", False)
    assert "the images are now" in found["error"]
    assert f"what they gave is in {tmp_path}" in caplog.text
    assert found["frames"] > 0 and (tmp_path / "trajectory.tum").is_file()


def test_a_stream_without_images_ends_after_the_timeout(
    walk: Walk, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with served("http", walk.left, RATE_HZ, end=30) as server:

        class Stop(Consumer):
            def step(self, done: int, estimate: Estimate) -> None:
                if done == 5:
                    server.stop()

        summary = run(
            server.url,
            tmp_path,
            config=FAST,
            calibration=walk.mono,
            progress=Stop(),
            timeout_s=1.0,
        )
    assert (summary.status, summary.facts.mode) == ("finished", "mono")
    assert summary.frames >= 5
    assert "no image for 1 s" in caplog.text
    assert "the run ends here" in caplog.text


def test_the_first_ctrl_c_finishes_a_live_run(walk: Walk, tmp_path: Path) -> None:
    class Press(Consumer):
        def step(self, done: int, estimate: Estimate) -> None:
            if done == 8:
                signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with served("http", walk.left, RATE_HZ) as server:
        summary = run(server.url, tmp_path, config=FAST, calibration=walk.mono, progress=Press())
    assert summary.status == "finished"
    assert 8 <= summary.frames <= 10  # those that were received before are tracked
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_ends_a_run_that_waits_for_images(walk: Walk, tmp_path: Path) -> None:
    with served("http", walk.left, RATE_HZ) as server:

        class Pause(Consumer):
            def step(self, done: int, estimate: Estimate) -> None:
                if done == 8:
                    server.is_paused = True
                    signal.signal(signal.SIGALRM, lambda *_: os.kill(os.getpid(), signal.SIGINT))
                    signal.setitimer(signal.ITIMER_REAL, 0.5)

        before = signal.getsignal(signal.SIGALRM)
        try:
            summary = run(
                server.url,
                tmp_path,
                config=FAST,
                calibration=walk.mono,
                progress=Pause(),
                timeout_s=60.0,
            )
        finally:
            signal.signal(signal.SIGALRM, before)
    assert summary.status == "finished"
    assert 8 <= summary.frames < 15


def test_a_run_ends_after_its_duration(walk: Walk, tmp_path: Path) -> None:
    with served("http", walk.left, RATE_HZ) as server:
        summary = run(server.url, tmp_path, config=FAST, calibration=walk.mono, duration_s=1.0)
    assert summary.status == "finished"
    assert 1 <= summary.frames <= 30


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"calibration": None}, CalibrationError, "a live camera needs `calibration=FILE`"),
        ({"side_by_side": False}, CalibrationError, "give `side_by_side`"),
        ({"mode": "stereo", "side_by_side": False}, SourceError, "is one camera; a pair is"),
        ({"follow": True}, SourceError, "`follow` is for recordings"),
        ({"topics": ["/a"]}, SourceError, "`topics` is for recordings"),
        ({"format": "video"}, SourceError, "`format` is for recordings"),
        ({"right_offset_ns": 5}, SourceError, "`right_offset_ns` is for recordings"),
        ({"config": load_config("fast", ["tracking.every=2"])}, ConfigError, "live source needs 1"),
    ],
)
def test_what_cannot_work_is_refused(
    options: dict[str, Any], error: type[Exception], message: str, walk: Walk, tmp_path: Path
) -> None:
    chosen = {"config": FAST, "calibration": walk.stereo, "side_by_side": True, **options}
    with served("http", walk.both, RATE_HZ) as server, pytest.raises(error, match=message):
        run(server.url, tmp_path / "out", **chosen)
    assert not (tmp_path / "out").exists()


def test_a_recorded_run_can_be_repeated(walk: Walk, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    consumer = Consumer(slow=range(5, 10), slow_s=0.1)  # what it drops is not recorded
    with served("rtsp", walk.both, RATE_HZ) as server:
        live = run(
            server.url,
            tmp_path / "live",
            config=FAST,
            calibration=walk.stereo,
            side_by_side=True,
            end=30,
            progress=consumer,
            record=log,
        )
    assert live.live is not None
    assert (live.live.unrecorded, live.live.dropped > 0) == (0, True)
    assert summary_in(tmp_path / "live")["live"]["unrecorded"] == 0
    again = run(log, tmp_path / "again", config=FAST)
    assert (again.frames, again.facts.mode) == (30, "stereo")
    one, other = (read_tum(tmp_path / name / "causal.tum") for name in ("live", "again"))
    np.testing.assert_array_equal(one.stamps_ns, other.stamps_ns)
    np.testing.assert_allclose(one.world_from_cam, other.world_from_cam, atol=1e-6)
    assert again.keyframes == live.keyframes


def test_a_recording_that_exists_is_not_replaced(walk: Walk, tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_text("precious")
    with served("http", walk.left, RATE_HZ) as server, pytest.raises(OutputError, match="exists"):
        run(
            server.url,
            tmp_path / "out",
            config=FAST,
            calibration=walk.mono,
            record=tmp_path / "log.mcap",
        )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "option", [{"timeout_s": 5.0}, {"duration_s": 5.0}, {"record": Path("log.mcap")}]
)
def test_options_of_live_sources_are_refused_for_recordings(
    option: dict[str, Any], synthetic_stereo: Path, tmp_path: Path
) -> None:
    with pytest.raises(SourceError, match="is for live sources, and .* is a recording"):
        run(synthetic_stereo, tmp_path / "out", config=FAST, **option)
