"""Small files that stand for gigabytes."""

from __future__ import annotations

import bz2
import sqlite3
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import zstandard

_MB = 10**6


def alias_yaml(levels: int = 9) -> str:
    """Lists that contain the list before nine times."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    for level in range(1, levels):
        items = ", ".join([f"*a{level - 1}"] * 9)
        lines.append(f"a{level}: &a{level} [{items}]")
    return "\n".join([*lines, f"cam0: *a{levels - 1}", ""])


def merge_yaml(levels: int = 40) -> str:
    """Mappings that are merged twice into the next."""
    lines = ["a0: &a0 {k: 1}"]
    lines += [f"a{n}: &a{n} {{<<: [*a{n - 1}, *a{n - 1}]}}" for n in range(1, levels)]
    return "\n".join([*lines, ""])


def png(width: int, height: int, colour: int = 0) -> bytes:
    """A PNG of zeros, of which the header states the size; its pixels are not all there."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        checksum = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", checksum)

    header = struct.pack(">IIBBBBB", width, height, 8, colour, 0, 0, 0)
    pixels = zlib.compress(bytes(50 * _MB))
    parts = ((b"IHDR", header), (b"IDAT", pixels), (b"IEND", b""))
    return b"".join((b"\x89PNG\r\n\x1a\n", *(chunk(kind, content) for kind, content in parts)))


def bag1(path: Path, compression: str, stated: int = 1000) -> None:
    """A ROS 1 bag of one chunk that unpacks to more than it states."""
    pack: dict[str, Callable[[], bytes]] = {
        "bz2": lambda: bz2.compress(bytes(50 * _MB)),
        "lz4": lambda: lz4.frame.compress(bytes(600 * _MB)),
    }

    def record(data: bytes, **fields: bytes) -> bytes:
        pairs = (f"{name}=".encode() + value for name, value in fields.items())
        header = b"".join(struct.pack("<I", len(pair)) + pair for pair in pairs)
        return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data

    size = struct.pack("<I", stated)
    chunk = record(pack[compression](), op=b"\x05", compression=compression.encode(), size=size)
    start = struct.pack("<Q", 0)
    head = record(b" " * 4000, op=b"\x03", index_pos=start, conn_count=size, chunk_count=size)
    path.write_bytes(b"#ROSBAG V2.0\n" + head + chunk)


def mcap(path: Path, compression: str, stated: int = 1000) -> None:
    """An MCAP file of one chunk that unpacks to 600 MB."""
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}[compression]
    data = pack(bytes(600 * _MB))
    name = compression.encode()
    header = struct.pack("<QQQII", 0, 1, stated, 0, len(name)) + name
    content = header + struct.pack("<Q", len(data)) + data
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(content)) + content)


_METADATA = """\
rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  relative_file_paths: [{name}]
  compression_format: zstd
  compression_mode: {mode}
"""
_TABLES = """\
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT,
    offered_qos_profiles TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
INSERT INTO topics VALUES (1, '/image', 'sensor_msgs/msg/Image', 'cdr', '');
"""
_ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) "
VIEWS = {
    "an endless view": f"""
DROP TABLE messages;
CREATE VIEW messages AS {_ENDLESS}
    SELECT x AS id, 1 AS topic_id, x AS timestamp, x'00' AS data FROM n;
""",
    "endless topics": f"""
DROP TABLE topics;
CREATE VIEW topics AS {_ENDLESS}
    SELECT x AS id, 'a' AS name, 'b' AS type, 'cdr' AS serialization_format FROM n;
""",
    "a computed column": """
DROP TABLE messages;
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,
    data BLOB GENERATED ALWAYS AS (zeroblob(900000000)));
INSERT INTO messages(topic_id, timestamp) VALUES (1, 1), (1, 2), (1, 3);
""",
}


def database(path: Path, more: str = "", message: bytes = b"") -> None:
    """A bag in SQLite, with tables changed or with a message."""
    connection = sqlite3.connect(path)
    connection.executescript(_TABLES + more)
    if message:
        connection.execute("INSERT INTO messages VALUES (1, 1, 1, ?)", (message,))
    connection.commit()
    connection.close()


def bag2(folder: Path, mode: str) -> None:
    """A ROS 2 bag of which the message or the file unpacks to 600 MB."""
    folder.mkdir()
    packed = zstandard.compress(bytes(600 * _MB))
    name = "bag_0.db3" if mode == "message" else "bag_0.db3.zstd"
    if mode == "message":
        database(folder / name, message=packed)
    else:
        (folder / name).write_bytes(packed)
    metadata = _METADATA.format(name=name, mode=mode.upper())
    (folder / "metadata.yaml").write_text(metadata, encoding="utf-8")
