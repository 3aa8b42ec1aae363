"""MCAP files larger than memory."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pytest
from mcap.writer import Writer

from vo.base.types import Camera
from vo.recordings.formats.messages import CalibrationMessage, ImageMessage
from vo.recordings.formats.ros2 import ROS2

WIDTH, HEIGHT = 4000, 2500
FILE_BYTES = 5 * 10**9
MEMORY_MB = 500

READ = """
import sys
from vo.outputs.results.environment import peak_rss_mb
from vo.recordings.sources.registry import open_source
source = open_source(sys.argv[1])
read = sum(1 for _ in source.frames(stride=4))  # a quarter shows what all would
print(len(source), read, peak_rss_mb())
"""


class Sparse:
    """A file with holes instead of zeros, so that it needs no disk space."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def write(self, data: bytes) -> int:
        hole = len(data) - 1000
        if hole > 10**6:
            self._stream.write(data[:1000])
            self._stream.seek(hole - 1000, 1)
            self._stream.write(data[hole:])
        else:
            self._stream.write(data)
        return len(data)

    def tell(self) -> int:
        return self._stream.tell()


def write_huge(path: Path) -> int:
    """Write black images without chunks, and return their number."""
    camera = Camera(WIDTH, HEIGHT, 2000.0, 2000.0, 2000.0, 1250.0)
    projection = np.column_stack([camera.matrix, np.zeros(3)])
    count = FILE_BYTES // (WIDTH * HEIGHT)
    black = bytes(WIDTH * HEIGHT)
    with path.open("wb") as stream:
        writer = Writer(Sparse(stream), use_chunking=False, enable_crcs=False)  # type: ignore[arg-type]
        writer.start(profile=ROS2.profile)
        channels = {}
        for topic, kind in (
            ("/cam/image_raw", ImageMessage),
            ("/cam/camera_info", CalibrationMessage),
        ):
            schema = ROS2.schema(kind)
            number = writer.register_schema(schema.name, ROS2.schema_encoding, schema.definition)
            channels[topic] = writer.register_channel(topic, ROS2.message_encoding, number)
        data = ROS2.encode(CalibrationMessage(1, "cam", camera, np.eye(3), projection))
        writer.add_message(channels["/cam/camera_info"], 1, data, 1)
        for i in range(1, count + 1):
            data = ROS2.encode(ImageMessage(i, "cam", WIDTH, HEIGHT, "mono8", black))
            writer.add_message(channels["/cam/image_raw"], i, data, i)
        writer.finish()
    return count


def test_five_gigabytes_are_read_with_little_memory(tmp_path: Path) -> None:
    if shutil.disk_usage(tmp_path).free < 2 * FILE_BYTES:
        pytest.skip("needs 10 GB of disk")
    path = tmp_path / "huge.mcap"
    count = write_huge(path)
    assert path.stat().st_size > FILE_BYTES
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path)], capture_output=True, text=True, check=True
    )
    path.unlink()
    listed, read, peak_mb = done.stdout.split()
    assert (int(listed), int(read)) == (count, count // 4)
    assert float(peak_mb) < MEMORY_MB
