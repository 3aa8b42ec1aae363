"""Files of object databases: nothing is lost, and nothing damaged is accepted."""

from __future__ import annotations

import hashlib
import struct
from pathlib import Path

import numpy as np
import pytest
from object_samples import stored

from vo.base.errors import ConfigError, OutputError, SourceError
from vo.tools.objects.database import ObjectDatabase
from vo.tools.objects.database_file import read_objects, write_objects


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two objects."""
    path = tmp_path_factory.mktemp("objects") / "two.vodb"
    database = ObjectDatabase()
    database.add("first", [stored(0)], width_m=0.2)
    database.add("zweites, größer", [stored(1)])
    database.save(path)
    return path


def test_nothing_is_lost(file: Path, tmp_path: Path) -> None:
    contents = read_objects(file)
    assert [each.name for each in contents.objects] == ["first", "zweites, größer"]
    assert contents.objects[0].parts[0].unit_m == pytest.approx(0.2 / 240)
    assert np.isnan(contents.objects[1].parts[0].unit_m)
    again = tmp_path / "again.vodb"
    write_objects(again, contents)
    assert again.read_bytes() == file.read_bytes()


def test_a_cut_file_is_refused(file: Path, tmp_path: Path) -> None:
    data, cut = file.read_bytes(), tmp_path / "cut.vodb"
    for length in (0, 4, 8, 12, 40, 500, len(data) // 2, len(data) - 1):
        cut.write_bytes(data[:length])
        with pytest.raises(SourceError, match="damaged or cut off|no database"):
            read_objects(cut)


def test_a_flipped_bit_is_noticed(file: Path, tmp_path: Path) -> None:
    data, flipped = bytearray(file.read_bytes()), tmp_path / "flipped.vodb"
    for at in np.linspace(0, len(data) - 1, 40).astype(int).tolist():
        changed = data.copy()
        changed[at] ^= 16
        flipped.write_bytes(changed)
        with pytest.raises(SourceError):
            read_objects(flipped)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"xy":["<f4"', b'"xy":["|O8"'),
        (b'"images":1', b'"images":{'),
        (b'"name":"first"', b'"eman":"first"'),
        (b'"size":["<f4",[', b'"size":["<f4",[9'),
        (b'"image_size":[240,180]', b'"image_size":[240,null]'),
    ],
)
def test_a_wrong_index_with_a_right_checksum_is_refused(
    file: Path, tmp_path: Path, old: bytes, new: bytes
) -> None:
    data = file.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    text = data[16 : 16 + length].replace(old, new, 1)
    assert text != data[16 : 16 + length]
    content = data[:12] + struct.pack("<I", len(text)) + text + data[16 + length : -32]
    path = tmp_path / "forged.vodb"
    path.write_bytes(content + hashlib.sha256(content).digest())
    with pytest.raises(SourceError, match="damaged"):
        read_objects(path)


def test_other_files_are_named(tmp_path: Path, file: Path) -> None:
    other = tmp_path / "other.vodb"
    other.write_bytes(b"something else")
    with pytest.raises(SourceError, match="is no database of objects; make one with"):
        read_objects(other)
    with pytest.raises(SourceError, match="cannot read the database"):
        read_objects(tmp_path / "missing.vodb")
    with pytest.raises(SourceError, match="cannot read the database"):
        read_objects(tmp_path)
    data = bytearray(file.read_bytes())
    data[8] = 9
    other.write_bytes(data)
    with pytest.raises(SourceError, match="version 9, this vo reads 2; update vo"):
        read_objects(other)


def test_a_file_that_cannot_be_written_is_an_error(file: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        write_objects(tmp_path / "missing" / "a.vodb", read_objects(file))


def test_features_that_are_not_installed_are_named(file: Path, tmp_path: Path) -> None:
    contents = read_objects(file)._replace(detector="surf")
    path = tmp_path / "surf.vodb"
    write_objects(path, contents)
    with pytest.raises(ConfigError, match="surf"):
        ObjectDatabase.load(path)
