"""Poses that leave a run while it goes on: in time, and to Foxglove."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from foxglove_client import FoxgloveClient
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame

from vo.base.config import load_config
from vo.base.types import Estimate, Frame
from vo.outputs.streaming.sink import PoseUpdate
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

FAST = load_config("fast")
FRAMES = 8


class Source:
    """A recording that tells when a frame is asked for, and may let it wait."""

    def __init__(self, folder: Path, events: list[tuple[str, int]]) -> None:
        self._source = open_source(folder)
        self._events = events
        self.gate = threading.Event()
        self.gate.set()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)

    def __len__(self) -> int:
        return len(self._source)

    def frames(self, *args: Any, **options: Any) -> Iterator[Frame]:
        assert self.gate.wait(60)
        for frame in self._source.frames(*args, **options):
            self._events.append(("read", frame.index))
            yield frame


class Watcher:
    """An output and a progress display that write down when they are called."""

    name = "watcher"

    def __init__(self, events: list[tuple[str, int]]) -> None:
        self._events = events
        self.is_closed = False

    def send(self, update: PoseUpdate) -> None:
        self._events.append(("sent", update.estimate.frame_index))

    def close(self) -> None:
        self.is_closed = True

    def begin(self, name: str, total: int) -> None: ...

    def step(self, done: int, estimate: Estimate) -> None:
        self._events.append(("written", estimate.frame_index))

    def finish(self) -> None: ...


def test_a_pose_is_sent_before_files_are_written_and_later_frames_are_tracked(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    events: list[tuple[str, int]] = []
    watcher = Watcher(events)
    source = Source(synthetic_stereo, events)
    run(source, tmp_path, config=FAST, end=FRAMES, poses=[watcher], progress=watcher)
    assert watcher.is_closed
    for frame in range(FRAMES):
        sent = events.index(("sent", frame))
        assert events.index(("read", frame)) < sent < events.index(("written", frame))
        if frame + 2 < FRAMES:  # one frame is read ahead
            assert sent < events.index(("read", frame + 2))


def test_outputs_are_closed_when_the_run_fails(synthetic_stereo: Path, tmp_path: Path) -> None:
    watcher = Watcher([])

    class Broken(Watcher):
        def step(self, done: int, estimate: Estimate) -> None:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run(synthetic_stereo, tmp_path, config=FAST, poses=[watcher], progress=Broken([]))
    assert watcher.is_closed


def test_foxglove_gets_the_path_of_a_run(
    synthetic_stereo: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
    source = Source(synthetic_stereo, [])
    source.gate.clear()
    caplog.set_level("INFO", "vo.outputs.streaming")
    clients: list[FoxgloveClient] = []

    def look() -> None:
        port = int(caplog.messages[0].rpartition(":")[2])
        client = FoxgloveClient(port)
        clients.append(client)
        client.subscribe()
        source.gate.set()
        client.receive()

    class Starting(Watcher):
        def begin(self, name: str, total: int) -> None:
            reader.start()

    reader = threading.Thread(target=look)
    run(source, tmp_path, config=FAST, end=FRAMES, poses=["ws://:0"], progress=Starting([]))
    reader.join(30)
    messages = clients[0].messages
    causal = read_tum(tmp_path / "causal.tum")
    assert [stamp for stamp, _ in messages["/pose"]] == causal.stamps_ns.tolist()
    assert [json.loads(data)["frame"] for _, data in messages["/estimate"]] == list(range(FRAMES))
    path = PosesInFrame.FromString(messages["/path"][-1][1]).poses
    for pose, position in zip(path, causal.positions.tolist(), strict=True):
        assert [pose.position.x, pose.position.y, pose.position.z] == pytest.approx(
            position, abs=1e-9
        )
