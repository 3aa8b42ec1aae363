"""Random damage to files: of bytes, of text, of structured values and of databases."""

from __future__ import annotations

import json
import random
import re
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

_TEXT_SUFFIXES = (".txt", ".csv", ".yaml", ".json", ".xml", ".tum", "")
_NUMBER = re.compile(r"-?\d+\.?\d*(?:[eE][+-]?\d+)?")
_WORDS = (
    *("nan", "inf", "-inf", "0", "-1", "1e308", "-1e308", "1e-320", "1e999"),
    *("9" * 400, "9" * 5000, "0x" + "f" * 5000),
    *("2001-99-99", "2001-01-01", "1:2:3:4:5:6:7:8", "text", "", "null", "~", "true", "[]", "{}"),
    *("[" * 3000, "{" * 3000, "&a [*a]", "!!python/object:os.system ls", "\x1b[2J", "\x00"),
    *("../../../etc/passwd", "/dev/zero", "\xed\xa0\x80"),
    *("1,2", ";", "9223372036854775808", "-9223372036854775809", "1.5", "\u202e", "a\nb"),
)
_VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 1, 2**31, 2**63, 10**30, 1e308, float("nan"), float("inf"), "", "text"),
    *("9" * 300, "\x1b[2J\x00", [], [[]], [1, "a", None], {}, {"a": {"b": []}}, [[1.0] * 4] * 4),
)
_SQL_VALUES: tuple[Any, ...] = (None, -1, 2**62, 1e308, "text", "", b"", b"\xff\xfe", "x" * 70000)
_NUMBERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**64 - 1)


def damage(file: Path, rng: random.Random) -> None:
    """Damage a file in place, by one to three changes."""
    is_database = file.suffix == ".db3"
    is_structured = file.suffix in (".json", ".yaml")
    is_text = file.suffix in _TEXT_SUFFIXES
    choice = rng.random()
    if is_database and choice < 0.6 and _damage_database(file, rng):
        return
    if is_structured and choice < 0.5 and _damage_structure(file, rng):
        return
    data = file.read_bytes()
    for _ in range(rng.randint(1, 3)):
        changes = _TEXT_CHANGES if is_text and rng.random() < 0.7 else _BYTE_CHANGES
        data = rng.choice(changes)(data, rng)
    file.write_bytes(data)


def _place(data: bytes, rng: random.Random) -> tuple[int, int]:
    """A range; often near the beginning or the end, where headers and indexes are."""
    size = len(data)
    where = rng.random()
    limit = min(size, 300) if where < 0.4 else size
    start = size - rng.randint(0, limit) if where < 0.2 else rng.randint(0, limit)
    return start, min(size, start + rng.choice((1, 2, 4, 8, 16, 100, 1000)))


def _flip(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 20))):
        start, _ = _place(data, rng)
        if start < len(changed):
            changed[start] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _cut(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randint(0, len(data))]


def _delete(data: bytes, rng: random.Random) -> bytes:
    start, end = _place(data, rng)
    return data[:start] + data[end:]


def _duplicate(data: bytes, rng: random.Random) -> bytes:
    start, end = _place(data, rng)
    return data[:end] + data[start:end] * rng.choice((1, 2, 50)) + data[end:]


def _exchange(data: bytes, rng: random.Random) -> bytes:
    (a, b), (c, d) = sorted((_place(data, rng), _place(data, rng)))
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:] if b <= c else data


def _number(data: bytes, rng: random.Random) -> bytes:
    start, _ = _place(data, rng)
    value, kind = rng.choice(_NUMBERS), rng.choice(["<H", ">H", "<I", ">I", "<Q", ">Q"])
    new = struct.pack(kind, value % 256 ** struct.calcsize(kind))
    return data[:start] + new + data[start + len(new) :]


def _insert(data: bytes, rng: random.Random) -> bytes:
    start, _ = _place(data, rng)
    new = rng.choice((b"\0" * 8, b"\xff\xfe\x80", rng.randbytes(9), b"[" * 2000, b"\n", b"\0"))
    return data[:start] + new + data[start:]


def _fill(data: bytes, rng: random.Random) -> bytes:
    start, end = _place(data, rng)
    return data[:start] + bytes([rng.choice((0, 0xFF, 0x20))]) * (end - start) + data[end:]


def _replace_number(data: bytes, rng: random.Random) -> bytes:
    text = data.decode("latin1")
    found = list(_NUMBER.finditer(text))
    if not found:
        return data
    chosen = rng.choice(found)
    new = rng.choice(_WORDS)
    return (text[: chosen.start()] + new + text[chosen.end() :]).encode("latin1", "ignore")


def _change_lines(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    number = rng.randrange(len(lines))
    change = rng.randrange(5)
    if change == 0:
        del lines[number]
    elif change == 1:
        lines.insert(number, lines[rng.randrange(len(lines))])
    elif change == 2:
        rng.shuffle(lines)
    elif change == 3:
        fields = lines[number].split(b" ")
        del fields[rng.randrange(len(fields))]
        lines[number] = b" ".join(fields)
    else:
        lines[number] = rng.choice(_WORDS).encode("utf-8", "replace")
    return b"\n".join(lines)


_Change = Callable[[bytes, random.Random], bytes]
_BYTE_CHANGES: tuple[_Change, ...] = (
    *(_flip, _flip, _cut, _delete, _duplicate, _exchange, _number, _number, _insert, _fill),
)
_TEXT_CHANGES: tuple[_Change, ...] = (_replace_number, _replace_number, _change_lines)


def _damage_structure(file: Path, rng: random.Random) -> bool:
    """Delete or replace values of JSON or YAML; False if it cannot be parsed."""
    try:
        text = file.read_text("utf-8")
        value = json.loads(text) if file.suffix == ".json" else yaml.safe_load(text)
    except (ValueError, yaml.YAMLError):
        return False
    places = list(_places(value))
    if not places:
        return False
    for _ in range(rng.randint(1, 2)):
        holder, key = rng.choice(places)
        try:
            if rng.random() < 0.4:
                del holder[key]
            else:
                holder[key] = rng.choice(_VALUES)
        except (KeyError, IndexError):
            continue
    dumped = json.dumps(value) if file.suffix == ".json" else yaml.safe_dump(value)
    file.write_text(dumped, encoding="utf-8")
    return True


def _places(value: Any) -> Any:
    if not isinstance(value, dict | list):
        return
    for key in list(value) if isinstance(value, dict) else range(len(value)):
        yield value, key
        yield from _places(value[key])


def _damage_database(file: Path, rng: random.Random) -> bool:
    """Replace a value, or a message, in a table of SQLite."""
    try:
        database = sqlite3.connect(file)
        tables = [row[0] for row in database.execute("SELECT name FROM sqlite_master")]
        table = rng.choice([t for t in tables if not t.startswith("sqlite_")])
        columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
        column, value = rng.choice(columns), rng.choice(_SQL_VALUES)
        if column == "data" and rng.random() < 0.8:
            row = database.execute(f"SELECT rowid, data FROM {table} LIMIT 1").fetchone()
            value = rng.choice(_BYTE_CHANGES)(row[1], rng)
        limit = rng.choice((1, 1000))
        database.execute(
            f"UPDATE {table} SET {column} = ? WHERE rowid IN (SELECT rowid FROM {table} LIMIT ?)",
            (value, limit),
        )
        database.commit()
        database.close()
    except (sqlite3.Error, IndexError, TypeError):
        return False
    return True
