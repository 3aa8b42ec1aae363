"""A client of Foxglove's websocket protocol, for tests."""

from __future__ import annotations

import json
import struct
from typing import Any

import pytest

TOPICS = {
    "/estimate": ("json", "vo.Estimate", "jsonschema"),
    "/path": ("protobuf", "foxglove.PosesInFrame", "protobuf"),
    "/pose": ("protobuf", "foxglove.PoseInFrame", "protobuf"),
    "/tf": ("protobuf", "foxglove.FrameTransforms", "protobuf"),
}
TIMEOUT_S = 10.0
_HEAD = struct.Struct("<BIQ")  # kind, subscription, time


class FoxgloveClient:
    """Subscribes to all topics, and keeps what comes.

    Args:
        port: of a server on this machine.

    Attributes:
        channels: what the server announces, by topic.
        messages: time and data of each message, by topic.
    """

    def __init__(self, port: int) -> None:
        client = pytest.importorskip("websockets.sync.client")
        address, protocols = f"ws://127.0.0.1:{port}", ["foxglove.sdk.v1"]
        self._socket = client.connect(address, subprotocols=protocols, legacy=True)
        self.channels: dict[str, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in TOPICS}
        while len(self.channels) < len(TOPICS):
            announced = json.loads(self._socket.recv(TIMEOUT_S))
            self.channels |= {each["topic"]: each for each in announced.get("channels", ())}

    def subscribe(self) -> None:
        """Subscribe to all topics; returns when the server has done that."""
        wanted = [{"id": c["id"], "channelId": c["id"]} for c in self.channels.values()]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        self._socket.ping().wait(TIMEOUT_S)  # answered after what was sent before

    def receive(self) -> None:
        """Keep messages until the server ends."""
        topics = {channel["id"]: topic for topic, channel in self.channels.items()}
        for message in self._socket:
            kind, channel, stamp_ns = _HEAD.unpack_from(message)
            assert kind == 1
            self.messages[topics[channel]].append((stamp_ns, message[_HEAD.size :]))
