from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from place_samples import make_place, random_descriptors

from vo.base.errors import OutputError, SourceError
from vo.base.geometry.transforms import se3_exp
from vo.base.types import Camera
from vo.engine.geometry.sim3 import similarity
from vo.engine.maps.map_file import MapFile, MapHeader, write_map
from vo.engine.places.encoding import decode_place, encode_place
from vo.engine.places.records import Loop, MarkerVisit, RegisteredKeyframes

RANDOM = np.random.default_rng(3)
PLACES = [make_place(n, random_descriptors(RANDOM, 40), segment=n // 3) for n in range(6)]
KEYS = tuple(place.key for place in PLACES)
HEADER = MapHeader(Camera(320, 240, 200.0, 201.0, 160.5, 120.5), "00e2", ("street", "room"))
POSES = np.stack([se3_exp(tangent) for tangent in RANDOM.normal(size=(6, 6))])
PLACED = RegisteredKeyframes(
    KEYS,
    np.array([0, 0, 0, 1, 1, 1]),
    POSES,
    RANDOM.uniform(0.5, 2, 6),
    np.full((6, 6, 6), np.nan),
    (),
)
LOOP = Loop(KEYS[0], KEYS[5], POSES[2], 0.7, np.eye(7), 42)
MARKERS = [
    MarkerVisit(KEYS[5], 7, "APRILTAG_36H11", 0.16, similarity(POSES[3], 0.7), np.eye(7), 5),
    MarkerVisit(KEYS[1], 0, "4X4_1000", 0.3, POSES[4], np.zeros((7, 7)), 3),
]


def _write(path: Path, markers: Sequence[MarkerVisit] = ()) -> Path:
    encoded = [(p.key, encode_place(p)) for p in PLACES]
    write_map(path, HEADER, encoded, PLACED, [LOOP], markers)
    return path


def test_everything_is_read_back_exactly(tmp_path: Path) -> None:
    with MapFile(_write(tmp_path / "a.map")) as read:
        assert (read.header, read.keys, len(read)) == (HEADER, KEYS, 6)
        for name in ("world", "world_from_cam", "scale", "covariance"):
            assert np.array_equal(getattr(read.placed, name), getattr(PLACED, name), equal_nan=True)
        (loop,) = read.loops
        assert (loop.earlier, loop.later, loop.scale, loop.inliers) == (KEYS[0], KEYS[5], 0.7, 42)
        assert np.array_equal(loop.earlier_from_later, LOOP.earlier_from_later)
        for place in PLACES:
            assert read.encoded(place.key) == encode_place(place)
            assert np.array_equal(read.place(place.key).landmarks.xyz, place.landmarks.xyz)


def test_markers_are_read_back_and_a_map_without_them_has_no_section(tmp_path: Path) -> None:
    with MapFile(_write(tmp_path / "a.map", MARKERS)) as read:
        for marker, expected in zip(read.markers, MARKERS, strict=True):
            numbers = [
                each._replace(cam_from_marker=0, covariance=0) for each in (marker, expected)
            ]
            assert numbers[0] == numbers[1]
            np.testing.assert_allclose(marker.cam_from_marker, expected.cam_from_marker, atol=1e-15)
            assert np.array_equal(marker.covariance, expected.covariance)
    path = _write(tmp_path / "b.map")
    assert b'"markers"' not in path.read_bytes()
    with MapFile(path) as read:
        assert read.markers == ()


def test_the_same_map_has_the_same_bytes(tmp_path: Path) -> None:
    first, second = (_write(tmp_path / name, MARKERS).read_bytes() for name in "ab")
    assert first == second


def test_an_empty_map_is_a_map(tmp_path: Path) -> None:
    none = RegisteredKeyframes(
        (), *(np.zeros(s) for s in (0, (0, 4, 4), 0, (0, 6, 6))), rejected=()
    )
    write_map(tmp_path / "a", HEADER, [], none)
    with MapFile(tmp_path / "a") as read:
        assert len(read) == len(read.loops) == 0


def _read_all(path: Path) -> None:
    with MapFile(path) as read:
        for key in read.keys:
            read.place(key)


def test_a_cut_file_is_one_error(tmp_path: Path) -> None:
    data = _write(tmp_path / "a", MARKERS).read_bytes()
    for size in [*range(0, 70), *range(70, len(data), 997), len(data) - 1]:
        (tmp_path / "cut").write_bytes(data[:size])
        with pytest.raises(SourceError, match="damaged or cut off|is no map"):
            _read_all(tmp_path / "cut")


def test_a_flipped_byte_is_found_wherever_it_is(tmp_path: Path) -> None:
    data = bytearray(_write(tmp_path / "a", MARKERS).read_bytes())
    for at in [*range(0, 12), *range(16, len(data), 499), *range(len(data) - 56, len(data))]:
        data[at] ^= 0x10
        (tmp_path / "flipped").write_bytes(data)
        with pytest.raises(SourceError, match="damaged or cut off|is no map|of version"):
            _read_all(tmp_path / "flipped")
        data[at] ^= 0x10


def test_foreign_newer_and_missing_files_have_messages_of_their_own(tmp_path: Path) -> None:
    data = bytearray(_write(tmp_path / "a").read_bytes())
    data[8] = 9
    (tmp_path / "new").write_bytes(data)
    with pytest.raises(SourceError, match="of version 9, this vo reads 1"):
        MapFile(tmp_path / "new")
    (tmp_path / "text").write_text("a text of some length, which is no map")
    with pytest.raises(SourceError, match="is no map"):
        MapFile(tmp_path / "text")
    for missing in (tmp_path / "none", tmp_path):
        with pytest.raises(SourceError, match="cannot read the map"):
            MapFile(missing)


def test_a_keyframe_that_is_something_else_is_a_value_error() -> None:
    data = encode_place(PLACES[0])
    for size in range(0, len(data), 61):
        with pytest.raises(ValueError):
            decode_place(data[:size])
    for old, new in ((b"xyz", b"xyq"), (b'"<f4"', b'"|O8"'), (b'"keyframe":0', b'"keyframe":-')):
        assert old in data
        with pytest.raises(ValueError):
            decode_place(data.replace(old, new, 1))


def test_a_folder_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write the map"):
        _write(tmp_path / "none" / "a")
    assert list(tmp_path.iterdir()) == []


_KILLED = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from test_map_file import HEADER, PLACED, PLACES
from vo.engine.places.encoding import encode_place
from vo.engine.maps.map_file import write_map

def slow():
    for place in PLACES:
        print("written", flush=True)
        yield place.key, encode_place(place)
        time.sleep(60)

write_map(Path(sys.argv[1]), HEADER, slow(), PLACED)
"""


def test_a_killed_process_leaves_the_old_map(tmp_path: Path) -> None:
    path = _write(tmp_path / "a")
    before = path.read_bytes()
    here = str(Path(__file__).parent)
    command = [sys.executable, "-P", "-c", _KILLED, str(path), here]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        os.kill(process.pid, signal.SIGKILL)
    assert path.read_bytes() == before
    _read_all(path)
