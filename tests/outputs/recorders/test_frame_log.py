"""Recording of live frames: the same frames again, and never a wait for the disk."""

from __future__ import annotations

import errno
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from vo.base.errors import OutputError
from vo.base.types import Camera, Frame, Rig
from vo.outputs.recorders import frame_log
from vo.outputs.recorders.durable_file import DurableFile
from vo.outputs.recorders.frame_log import FrameLog
from vo.recordings.sources.registry import open_source

WIDTH, HEIGHT = 96, 64
CAM1_FROM_CAM0 = np.eye(4)
CAM1_FROM_CAM0[:3, 3] = (-0.12, 0.001, 0.002)
LENSES = {
    "none": (),
    "radtan": (-0.28, 0.07, 0.0002, 1e-05, 0.003),
    "equidistant": (-0.013, 0.02, -0.012, 0.002),
    "double_sphere": (-0.2, 0.59),
}


def rig_of(model: str = "radtan", *, is_stereo: bool = True) -> Rig:
    camera = Camera(WIDTH, HEIGHT, 80.5, 80.25, 47.1, 31.2, model, LENSES[model])  # type: ignore[arg-type]
    return Rig(camera, camera, CAM1_FROM_CAM0) if is_stereo else Rig(camera)


def frames(count: int, cameras: int = 2) -> Iterator[Frame]:
    rng = np.random.default_rng(0)
    for i in range(count):
        images = rng.integers(0, 256, (cameras, HEIGHT, WIDTH), dtype=np.uint8)
        yield Frame(i, 1_700_000_000_000_000_000 + i * 33_333_333 + i % 3, tuple(images))


def record(path: Path, rig: Rig, taken: list[Frame]) -> FrameLog:
    log = FrameLog(path, rig)
    for frame in taken:
        log.add(frame)
    log.close()
    return log


def wait_for_writer(log: FrameLog, count: int) -> None:
    give_up = time.monotonic() + 10.0
    while log._written < count:
        assert time.monotonic() < give_up
        time.sleep(0.01)


@pytest.mark.parametrize("model", LENSES)
@pytest.mark.parametrize("is_stereo", [True, False])
def test_the_same_frames_are_read_again(model: str, is_stereo: bool, tmp_path: Path) -> None:
    rig, taken = rig_of(model, is_stereo=is_stereo), list(frames(12, 1 + is_stereo))
    assert record(tmp_path / "log.mcap", rig, taken).unrecorded == 0
    source = open_source(tmp_path / "log.mcap")
    assert source.rig.cameras == rig.cameras
    if is_stereo:
        assert source.rig.cam1_from_cam0 is not None
        np.testing.assert_allclose(source.rig.cam1_from_cam0, CAM1_FROM_CAM0, atol=1e-12)
    read = list(source.frames())
    assert [frame.stamp_ns for frame in read] == [frame.stamp_ns for frame in taken]
    for one, other in zip(read, taken, strict=True):
        np.testing.assert_array_equal(one.image0, other.image0)
        if is_stereo:
            np.testing.assert_array_equal(one.image1, other.image1)


def test_a_slow_disk_loses_frames_of_the_recording_and_no_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    free = threading.Event()
    write = DurableFile.write

    def slow(self: DurableFile, data: bytes) -> int:
        assert free.wait(20.0)
        return write(self, data)

    monkeypatch.setattr(DurableFile, "write", slow)
    monkeypatch.setattr(frame_log, "_QUEUE_BYTES", 10 * 2 * WIDTH * HEIGHT)
    log = FrameLog(tmp_path / "log.mcap", rig_of())
    for frame in frames(100):
        log.add(frame)  # would wait forever
    assert log.unrecorded == 90
    free.set()
    log.close()
    assert len(open_source(tmp_path / "log.mcap")) == 10
    assert "frames are left out, because the disk is too slow" in caplog.text


def test_what_a_killed_process_leaves_is_readable(tmp_path: Path) -> None:
    log = FrameLog(tmp_path / "log.mcap", rig_of())
    for frame in frames(20):
        log.add(frame)
    wait_for_writer(log, 20)
    time.sleep(2 * frame_log._FLUSH_S)
    shutil.copy(tmp_path / "log.mcap", tmp_path / "killed.mcap")
    log.close()
    assert len(list(open_source(tmp_path / "killed.mcap").frames())) == 20


def test_a_full_disk_ends_the_recording_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(frame_log, "_FLUSH_S", 0.0)  # a chunk for each frame
    write = DurableFile.write

    def limited(self: DurableFile, data: bytes) -> int:
        if self.tell() + len(data) > 200_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(self, data)

    monkeypatch.setattr(DurableFile, "write", limited)
    log = FrameLog(tmp_path / "log.mcap", rig_of())
    for frame in frames(30):
        log.add(frame)
    log._thread.join(10.0)
    log.add(next(frames(1)))
    log.close()
    assert log.unrecorded > 0
    assert "recording ended: No space left on device" in caplog.text
    assert 5 < len(open_source(tmp_path / "log.mcap")) < 30


def test_nothing_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_text("precious")
    for name, message in (("log.mcap", "exists; give `record` another"), ("log.bag", "ends in")):
        with pytest.raises(OutputError, match=message):
            FrameLog(tmp_path / name, rig_of())
    assert (tmp_path / "log.mcap").read_text() == "precious"


def test_a_recording_without_frames_leaves_no_file(tmp_path: Path) -> None:
    record(tmp_path / "log.mcap", rig_of(), [])
    assert not list(tmp_path.iterdir())
