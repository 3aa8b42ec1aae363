"""Poses for Foxglove, read by a client of its websocket protocol."""

from __future__ import annotations

import json
import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from foxglove_client import TIMEOUT_S, TOPICS, FoxgloveClient
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from pose_updates import estimate, lost, pose, update

from vo.base.errors import MissingExtraError, OutputError
from vo.outputs.streaming.sink import SCHEMA_FILE, PoseRecords, PoseUpdate, ThinnedPath, encoded
from vo.outputs.streaming.streams import open_address

pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")

from vo.outputs.streaming.foxglove_server import FoxgloveServer  # noqa: E402 - needs the extra


@pytest.fixture
def server() -> Iterator[FoxgloveServer]:
    with closing(FoxgloveServer("ws://:0", "127.0.0.1", 0)) as opened:
        yield opened


def stamps(messages: list[tuple[int, bytes]]) -> list[int]:
    return [stamp_ns for stamp_ns, _ in messages]


def test_a_client_gets_every_frame_as_foxglove_s_messages(server: FoxgloveServer) -> None:
    reader = FoxgloveClient(server.port)
    for topic, expected in TOPICS.items():
        channel = reader.channels[topic]
        found = (channel["encoding"], channel["schemaName"], channel["schemaEncoding"])
        assert found == expected
    schema = json.loads(reader.channels["/estimate"]["schema"])
    assert schema == json.loads(SCHEMA_FILE.read_text(encoding="utf-8"))
    reader.subscribe()
    records = PoseRecords(is_metric=True)
    estimates = [estimate(0), estimate(1), lost(2), estimate(3)]
    for each in estimates:
        server.send(PoseUpdate(each, encoded(records.record(each))))
    server.close()
    reader.receive()

    received = reader.messages
    assert stamps(received["/estimate"]) == [each.stamp_ns for each in estimates]
    assert [json.loads(data)["frame"] for _, data in received["/estimate"]] == [0, 1, 2, 3]
    posed = [each.stamp_ns for each in estimates if each.world_from_cam0 is not None]
    assert stamps(received["/pose"]) == stamps(received["/tf"]) == posed
    last = PoseInFrame.FromString(received["/pose"][-1][1])
    assert last.frame_id == "world"
    assert last.timestamp.seconds * 10**9 + last.timestamp.nanos == posed[-1]
    position = last.pose.position
    assert [position.x, position.y, position.z] == pose(3)[:3, 3].tolist()
    assert last.pose.orientation.y == pytest.approx(np.sin(0.15))
    (transform,) = FrameTransforms.FromString(received["/tf"][-1][1]).transforms
    assert (transform.parent_frame_id, transform.child_frame_id) == ("world", "cam0")
    whole = PosesInFrame.FromString(received["/path"][-1][1])
    assert [each.position.z for each in whole.poses] == [0.0, 1.0, 3.0]


def test_a_client_that_reads_nothing_neither_slows_the_run_nor_grows_its_memory(
    caplog: pytest.LogCaptureFixture,
) -> None:
    server = FoxgloveServer("ws://:0", "127.0.0.1", 0)
    stalled = stalled_client(server)
    updates = [update(frame) for frame in range(10)]
    before_kb = resident_kb()
    for number in range(20_000):
        server.send(updates[number % 10])
    assert resident_kb() - before_kb < 20_000
    reader = FoxgloveClient(server.port)  # others are served
    reader.subscribe()
    server.send(update(5))
    begun = time.monotonic()
    server.close()
    assert time.monotonic() - begun < TIMEOUT_S / 2
    reader.receive()
    assert len(reader.messages["/pose"]) == 1
    stalled.close()
    assert caplog.messages == []


def stalled_client(server: FoxgloveServer) -> socket.socket:
    """A client that subscribes to everything and then never reads."""
    raw = socket.socket()
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    raw.connect(("127.0.0.1", server.port))
    raw.sendall(
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
    )
    answer = b""
    while not answer.endswith(b"\r\n\r\n"):
        answer += raw.recv(1)
    channels = (server._tf, server._pose, server._path, server._estimate)
    wanted = [{"id": each.id(), "channelId": each.id()} for each in channels]
    text = json.dumps({"op": "subscribe", "subscriptions": wanted}).encode()
    mask = b"\x01\x02\x03\x04"
    masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(text))
    raw.sendall(struct.pack(">BBH", 0x81, 0x80 | 126, len(text)) + mask + masked)
    deadline = time.monotonic() + TIMEOUT_S
    while not server._path.has_sinks():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return raw


def resident_kb() -> int:
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * 4


def test_by_default_only_this_machine_can_connect() -> None:
    free = free_port()
    with closing(open_address(f"ws://:{free}")):
        with closing(socket.create_connection(("127.0.0.1", free), TIMEOUT_S)):
            pass
        with pytest.raises(OSError):
            socket.create_connection(("127.0.0.2", free), TIMEOUT_S)
    with closing(open_address(f"ws://0.0.0.0:{free_port()}")) as everywhere:
        assert isinstance(everywhere, FoxgloveServer)
        with closing(socket.create_connection(("127.0.0.2", everywhere.port), TIMEOUT_S)):
            pass


@pytest.mark.parametrize(
    ("origin", "is_let_in"),
    [
        ("", True),
        ("http://localhost:3000", True),
        ("https://app.foxglove.dev", True),
        ("https://evil.example", False),
        ("http://localhost.evil.example", False),
        ("null", False),
        ("https://mine.example", True),
    ],
)
def test_foreign_web_pages_are_refused(origin: str, is_let_in: bool) -> None:
    server = FoxgloveServer("ws://:0", "127.0.0.1", 0, ["https://mine.example/"])
    with closing(server), closing(socket.create_connection(("127.0.0.1", server.port))) as raw:
        line = f"Origin: {origin}\r\n" if origin else ""
        raw.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n{line}Upgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        raw.settimeout(TIMEOUT_S)
        assert raw.recv(12) == (b"HTTP/1.1 101" if is_let_in else b"HTTP/1.1 403")


def free_port() -> int:
    with closing(socket.socket()) as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


@pytest.mark.parametrize("host", ["127.0.0.1", "no.such.host.invalid", "192.0.2.1"])
def test_what_cannot_be_listened_on_is_refused(server: FoxgloveServer, host: str) -> None:
    address = f"ws://{host}:{server.port}"
    with pytest.raises(OutputError) as refusal:
        open_address(address)
    message = str(refusal.value)
    assert message.startswith(f"{address}: ")
    assert message.endswith("choose another host or port")
    assert ("in use" in message) == (host == "127.0.0.1")


def test_a_missing_package_is_named_with_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(MissingExtraError, match=r"visual-odometry\[foxglove\]"):
        open_address("ws://:0")


def test_the_path_stays_short_and_forgets_withdrawn_frames() -> None:
    path = ThinnedPath(max_poses=8)
    for frame in range(100):
        path.add(frame, pose(frame))
        assert len(path) <= 8
    z = path.poses()[:, 2, 3]
    assert (z[0], len(set(np.diff(z)))) == (0.0, 1)  # even steps
    path.withdraw_from(40)
    assert path.poses()[:, 2, 3].max() < 40
