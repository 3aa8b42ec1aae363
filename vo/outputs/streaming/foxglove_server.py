"""Poses for Foxglove: a server of its websocket protocol, which the package foxglove-sdk provides.

Topics: `/tf` and `/pose` as in the MCAP output, `/path` (the poses so far, thinned out), and
`/estimate` (the JSON record of each frame).
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from secrets import randbelow
from typing import TYPE_CHECKING, Any

from vo.base.errors import OutputError
from vo.base.extras import require
from vo.outputs.streaming.origin_gate import OriginGate
from vo.outputs.streaming.sink import SCHEMA_FILE, PoseUpdate, ThinnedPath
from vo.recordings.formats.foxglove import encode, schema
from vo.recordings.formats.foxglove_scene import path_message, path_schema
from vo.recordings.formats.messages import FrameTransform, PoseMessage, Schema, TransformsMessage

if TYPE_CHECKING:
    from foxglove import Channel

_WORLD, _CAM0 = "world", "cam0"
_BACKLOG = 256  # messages that wait for a slow client, which then misses the oldest
_PATH_EVERY_S = 1.0
_LAST_PATH_S = 0.5  # for the last path to leave
_CLOSE_S = 1.0
_OWN = "127.0.0.1"

_log = logging.getLogger(__name__)


def _start_server(foxglove: Any, context: Any) -> tuple[Any, str]:
    """The server behind the gate and its address, one that web pages do not know."""
    for host in (f"127.{randbelow(254) + 1}.{randbelow(256)}.{randbelow(254) + 1}", _OWN):
        with suppress(RuntimeError, ValueError):  # not every system has all of 127.0.0.0/8
            options = {"context": context, "message_backlog_size": _BACKLOG}
            return foxglove.start_server(name="vo", host=host, port=0, **options), host
    raise RuntimeError("the server of Foxglove does not start")


class FoxgloveServer:
    """Serves the poses; clients may come and go, and can send nothing.

    Messages are sent by threads of the package, so that no client can make the run wait.

    `host`: address of this machine to listen on. `port`: to listen on; 0 for any free one.
    `allow_origins`: web pages that may connect, see `OriginGate`.

    Raises:
        MissingExtraError: the package is not installed.
        OutputError: the port is taken, or the host is not this machine.
    """

    def __init__(self, name: str, host: str, port: int, allow_origins: Sequence[str] = ()) -> None:
        self.name = name
        foxglove = require("foxglove", "foxglove", "poses for Foxglove")
        self._context = foxglove.Context()
        try:
            self._server, inner = _start_server(foxglove, self._context)
            try:
                self._gate = OriginGate(host, port, (inner, self._server.port), allow_origins)
            except BaseException:
                self._server.stop()
                raise
        except (RuntimeError, ValueError, OSError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise OutputError(f"{name}: {reason}; choose another host or port") from error
        self.port: int = self._gate.port
        self._tf = self._channel("/tf", schema(TransformsMessage))
        self._pose = self._channel("/pose", schema(PoseMessage))
        self._path = self._channel("/path", path_schema())
        record = Schema("vo.Estimate", SCHEMA_FILE.read_bytes())
        self._estimate = self._channel("/estimate", record, encoding="json")
        self._poses = ThinnedPath()
        self._stamp_ns = 0
        self._path_due = 0.0
        shown_host = f"[{host}]" if ":" in host else host
        _log.info("poses for Foxglove at ws://%s:%d", shown_host, self.port)

    def _channel(self, topic: str, schema: Schema, encoding: str = "protobuf") -> Channel:
        from foxglove import Channel
        from foxglove import Schema as SdkSchema

        of_schema = "jsonschema" if encoding == "json" else encoding
        definition = SdkSchema(name=schema.name, encoding=of_schema, data=schema.definition)
        return Channel(topic, schema=definition, message_encoding=encoding, context=self._context)

    def send(self, update: PoseUpdate) -> None:
        """Send a frame to all clients; the path once a second."""
        estimate = update.estimate
        stamp_ns, pose = estimate.stamp_ns, estimate.world_from_cam0
        self._stamp_ns = max(stamp_ns, 0)  # a time of the protocol is not negative
        self._estimate.log(update.record, log_time=self._stamp_ns)
        if estimate.tracked_anew_from is not None:
            self._poses.withdraw_from(estimate.tracked_anew_from)
        if pose is None:
            return
        transform = TransformsMessage(stamp_ns, (FrameTransform(_WORLD, _CAM0, pose),))
        self._tf.log(encode(transform), log_time=self._stamp_ns)
        self._pose.log(encode(PoseMessage(stamp_ns, _WORLD, pose)), log_time=self._stamp_ns)
        self._poses.add(estimate.frame_index, pose)
        now = time.monotonic()
        if now >= self._path_due:
            self._send_path()
            self._path_due = now + _PATH_EVERY_S

    def _send_path(self) -> None:
        if len(self._poses) and self._path.has_sinks():
            message = path_message(self._stamp_ns, _WORLD, self._poses.poses())
            self._path.log(message.SerializeToString(), log_time=self._stamp_ns)

    def close(self) -> None:
        """Send the whole path, and stop the server."""
        self._send_path()
        if self._path.has_sinks():
            time.sleep(_LAST_PATH_S)  # the package drops what is queued when it stops
        self._gate.close()
        # The package would wait a minute for a client that does not read.
        stopping = threading.Thread(target=self._server.stop, daemon=True)
        stopping.start()
        stopping.join(_CLOSE_S)
