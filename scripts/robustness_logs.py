"""Layouts in which stamps can be wrong: logs whose clock was set back, times in other units."""

from __future__ import annotations

import struct
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

from robustness_clips import Clip, write_euroc, write_kitti

Write = Callable[[Clip, Path], Path]
_CDR_STAMP = "<iI"  # std_msgs/Header.stamp after the 4 bytes of the encapsulation


def times_in(units_per_s: float) -> Write:
    """KITTI's times.txt in milliseconds or nanoseconds."""
    return lambda clip, folder: write_kitti(clip, folder, units_per_s)


def clock_set_back(vo: Path, seconds: float, after: int) -> Write:
    """A ROS 2 MCAP whose header stamps jump back after a frame; the log times go on."""

    def write(clip: Clip, folder: Path) -> Path:
        with tempfile.TemporaryDirectory() as name:
            plain, log = write_euroc(clip, Path(name) / "plain"), Path(name) / "log.mcap"
            command = [str(vo), "convert", str(plain), str(log), "--to", "mcap-ros2", "--quiet"]
            subprocess.run(command, check=True)
            folder.mkdir(parents=True)
            _with_stamps_set_back(log, folder / "log.mcap", seconds, after)
        return folder / "log.mcap"

    return write


def _with_stamps_set_back(old: Path, new: Path, seconds: float, after: int) -> None:
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with old.open("rb") as source, new.open("wb") as target:
        writer = Writer(target)
        writer.start("ros2")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        messages = list(make_reader(source).iter_messages(log_time_order=True))
        times = sorted({m.log_time for _, c, m in messages if c.topic.startswith("/cam0/image")})
        for schema, channel, message in messages:
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                )
            data = bytearray(message.data)
            if channel.topic.startswith("/cam") and message.log_time >= times[after]:
                sec, ns = struct.unpack_from(_CDR_STAMP, data, 4)
                stamp = sec * 10**9 + ns - round(seconds * 1e9)
                struct.pack_into(_CDR_STAMP, data, 4, stamp // 10**9, stamp % 10**9)
            time = message.log_time
            writer.add_message(channels[channel.id], time, bytes(data), time)
        writer.finish()
