"""Maps whose parts have the right checksums, and content that `vo` never writes."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from place_samples import make_place, random_descriptors
from typer.testing import CliRunner

from vo.base.errors import SourceError
from vo.base.types import Camera
from vo.cli.app import app
from vo.engine.maps import map_file
from vo.engine.maps.map_file import MapFile, MapHeader, write_map
from vo.engine.places.encoding import encode_place
from vo.engine.places.records import Loop, MarkerVisit, Place, RegisteredKeyframes
from vo.tools.maps.contents import map_contents

RANDOM = np.random.default_rng(4)
PLACES = [make_place(n, random_descriptors(RANDOM, 40)) for n in range(3)]
KEYS = tuple(place.key for place in PLACES)
HEADER = MapHeader(Camera(320, 240, 200.0, 201.0, 160.5, 120.5), "00e2", ("street",))
LOOP = Loop(KEYS[0], KEYS[2], np.eye(4), 1.0, np.eye(7), 42)
MARKER = MarkerVisit(KEYS[1], 7, "4X4_1000", 0.16, np.eye(4), 1e-4 * np.eye(7), 5)


def _placed(**changes: Any) -> RegisteredKeyframes:
    poses = np.stack([np.eye(4)] * 3)
    rows = (np.zeros(3, np.int64), poses, np.ones(3), np.zeros((3, 6, 6)))
    return replace(RegisteredKeyframes(KEYS, *rows, rejected=()), **changes)


def _write(
    path: Path,
    *,
    second: Place = PLACES[1],
    registered: RegisteredKeyframes | None = None,
    loop: Loop = LOOP,
    header: MapHeader = HEADER,
    marker: MarkerVisit = MARKER,
) -> None:
    places = PLACES[0], second, PLACES[2]
    encoded = [(key, encode_place(place)) for key, place in zip(KEYS, places, strict=True)]
    write_map(path, header, encoded, registered or _placed(), [loop], [marker])


def _read(path: Path) -> None:
    with MapFile(path) as file:
        map_contents(file)


def _is_damaged(path: Path) -> None:
    with pytest.raises(SourceError, match="damaged or cut off"):
        _read(path)


def _forge(path: Path, change: Callable[[dict[str, Any]], Any] | bytes) -> None:
    """Replace the index, and sign the new one."""
    data = path.read_bytes()
    tail = map_file._TAIL
    begin, length, _, magic = tail.unpack(data[-tail.size :])
    if isinstance(change, bytes):
        text = change
    else:
        index = json.loads(data[begin : begin + length])
        change(index)
        text = json.dumps(index).encode()
    digest = hashlib.sha256(text).digest()
    path.write_bytes(data[:begin] + text + tail.pack(begin, len(text), digest, magic))


def test_the_samples_themselves_are_a_map(tmp_path: Path) -> None:
    path = tmp_path / "a.map"
    _write(path)
    _forge(path, lambda index: None)
    _read(path)


INDICES: dict[str, Callable[[dict[str, Any]], Any] | bytes] = {
    "no object": b"[1, 2]",
    "nothing": b"",
    "no text": b"\xff\xfe\x00",
    "nested": b"[" * 100_000,
    "width of 0": lambda index: index["camera"].update(width=0),
    "width as text": lambda index: index["camera"].update(width="320"),
    "no focal length": lambda index: index["camera"].update(fx=None),
    "negative focal length": lambda index: index["camera"].update(fy=-1.0),
    "infinite focal length": lambda index: index["camera"].update(fx=float("nan")),
    "distortion": lambda index: index["camera"].update(distortion_model="radtan"),
    "unknown field": lambda index: index["camera"].update(colour="red"),
    "vocabulary": lambda index: index.update(vocabulary=[1]),
    "sessions as text": lambda index: index.update(sessions="abc"),
    "no sessions": lambda index: index.update(sessions=[]),
    "metric worlds as text": lambda index: index.update(metric_worlds="12"),
    "half a world": lambda index: index.update(metric_worlds=[0.5]),
    "half a keyframe": lambda index: index["keyframes"][1].__setitem__(1, 0.5),
    "huge keyframe": lambda index: index["keyframes"][1].__setitem__(1, 10**30),
    "keyframe twice": lambda index: index["keyframes"].__setitem__(1, index["keyframes"][0]),
    "no part": lambda index: index["keyframes"].__setitem__(1, [0]),
    "part before the file": lambda index: index["keyframes"][1].__setitem__(2, -8),
    "part beyond the file": lambda index: index["keyframes"][1].__setitem__(3, 2**40),
    "half a row": lambda index: index["placements"].__setitem__(1, 300),
    "no loops": lambda index: index.update(loops=None),
    "markers as text": lambda index: index.update(markers="7"),
    "no rows of markers": lambda index: index["markers"].pop("rows"),
    "half a row of a marker": lambda index: index["markers"]["rows"].__setitem__(1, 300),
    "rows of markers beyond the file": lambda index: index["markers"]["rows"].__setitem__(0, 2**40),
    "negative version of markers": lambda index: index["markers"].update(version=-1),
    "unknown dictionary": lambda index: index["markers"].update(dictionaries=["9X9_50"]),
    "dictionary as number": lambda index: index["markers"].update(dictionaries=[1]),
    "no dictionaries": lambda index: index["markers"].update(dictionaries=[]),
}


@pytest.mark.parametrize("change", INDICES.values(), ids=INDICES.keys())
def test_an_impossible_index_is_one_error(
    change: Callable[[dict[str, Any]], Any] | bytes, tmp_path: Path
) -> None:
    path = tmp_path / "a.map"
    _write(path)
    _forge(path, change)
    _is_damaged(path)


FAR = np.eye(4)
FAR[0, 3] = 1e200
PLACEMENTS = {
    "scale of 0": {"scale": np.array([1.0, 0.0, 1.0])},
    "negative scale": {"scale": np.array([1.0, -1.0, 1.0])},
    "huge scale": {"scale": np.array([1.0, 1e300, 1.0])},
    "no pose": {"world_from_cam": np.zeros((3, 4, 4))},
    "sheared": {"world_from_cam": np.stack([np.eye(4), 2.0 * np.eye(4), np.eye(4)])},
    "mirrored": {"world_from_cam": np.stack([np.diag([1.0, 1.0, -1.0, 1.0])] * 3)},
    "far away": {"world_from_cam": np.stack([np.eye(4), FAR, np.eye(4)])},
    "negative world": {"world": np.array([0, -1, 0])},
    "huge world": {"world": np.array([0, 2**63 - 1, 0])},
    "negative variance": {"covariance": -np.ones((3, 1, 1)) * np.eye(6)},
}


@pytest.mark.parametrize("changes", PLACEMENTS.values(), ids=PLACEMENTS.keys())
def test_an_impossible_placement_is_one_error(changes: dict[str, Any], tmp_path: Path) -> None:
    _write(tmp_path / "a.map", registered=_placed(**changes))
    _is_damaged(tmp_path / "a.map")


@pytest.mark.parametrize(
    "changes",
    [
        {"earlier_from_later": np.full((4, 4), np.nan)},
        {"scale": -1.0},
        {"covariance": np.full((7, 7), np.nan)},
        {"covariance": -np.eye(7)},
        {"later": KEYS[0]._replace(session=-1)},
    ],
)
def test_an_impossible_loop_is_one_error(changes: dict[str, Any], tmp_path: Path) -> None:
    _write(tmp_path / "a.map", loop=replace(LOOP, **changes))
    _is_damaged(tmp_path / "a.map")


LARGE, SKEWED = 1e-4 * np.eye(7), 1e-4 * np.eye(7)
LARGE[0, 0], SKEWED[0, 1] = 1e300, 1e-4


@pytest.mark.parametrize(
    "changes",
    [
        {"key": KEYS[0]._replace(keyframe=77)},
        {"id": -1},
        {"id": 1000},
        {"length_m": 0.0},
        {"length_m": -0.16},
        {"length_m": 160.0},
        {"length_m": float("nan")},
        {"cam_from_marker": np.full((4, 4), np.nan)},
        {"cam_from_marker": np.diag([1.0, 1.0, -1.0, 1.0])},
        {"cam_from_marker": FAR},
        {"cam_from_marker": np.diag([1e-12, 1e-12, 1e-12, 1.0])},
        {"covariance": np.full((7, 7), np.nan)},
        {"covariance": -np.eye(7)},
        {"covariance": LARGE},
        {"covariance": SKEWED},
        {"keyframes": 0},
        {"keyframes": 2**40},
    ],
    ids=str,
)
def test_an_impossible_marker_is_one_error(changes: dict[str, Any], tmp_path: Path) -> None:
    with np.errstate(invalid="ignore"):
        _write(tmp_path / "a.map", marker=MARKER._replace(**changes))
    _is_damaged(tmp_path / "a.map")


def test_markers_of_a_newer_version_are_one_error(tmp_path: Path) -> None:
    _write(tmp_path / "a.map")
    _forge(tmp_path / "a.map", lambda index: index["markers"].update(version=2))
    with pytest.raises(SourceError, match=r"has markers of version 2, this vo reads 1; update vo"):
        _read(tmp_path / "a.map")


MARKS = PLACES[1].landmarks
COUNT = len(MARKS.id)
LANDMARKS = {
    "narrow descriptors": {"descriptor": MARKS.descriptor[:, :16].copy()},
    "other descriptors": {"descriptor": np.zeros((COUNT, 32), np.float32)},
    "negative ids": {"id": MARKS.id - 10**6},
    "huge ids": {"id": MARKS.id + 2**40},
    "huge octave": {"octave": np.full(COUNT, 2**31 - 1, np.int32)},
    "negative octave": {"octave": np.full(COUNT, -1, np.int32)},
    "no position": {"xyz": np.full((COUNT, 3), np.nan, np.float32)},
    "far away": {"xyz": np.full((COUNT, 3), 3e38, np.float32)},
    "exact depth": {"sigma": np.zeros(COUNT, np.float32)},
    "negative uncertainty": {"sigma": np.full(COUNT, -1.0, np.float32)},
    "no uncertainty": {"sigma": np.full(COUNT, np.nan, np.float32)},
    "no pixel": {"xy": np.full((COUNT, 2), np.nan, np.float32)},
}


@pytest.mark.parametrize("changes", LANDMARKS.values(), ids=LANDMARKS.keys())
def test_impossible_landmarks_are_one_error(changes: dict[str, Any], tmp_path: Path) -> None:
    second = replace(PLACES[1], landmarks=replace(MARKS, **changes))
    _write(tmp_path / "a.map", second=second)
    _is_damaged(tmp_path / "a.map")


@pytest.mark.parametrize(
    "changes",
    [
        {"odom_from_cam": np.full((4, 4), 2.0)},
        {"covariance": np.full((6, 6), np.nan)},
        {"covariance": -np.eye(6)},
        {"thumbnail": np.zeros((0, 0), np.uint8)},
        {"frame": replace(PLACES[1].frame, segment=2**62)},
        {"key": KEYS[1]._replace(keyframe=77)},
    ],
)
def test_an_impossible_keyframe_is_one_error(changes: dict[str, Any], tmp_path: Path) -> None:
    _write(tmp_path / "a.map", second=replace(PLACES[1], **changes))
    _is_damaged(tmp_path / "a.map")


def test_a_keyframe_of_an_unknown_session_is_one_error(tmp_path: Path) -> None:
    _write(tmp_path / "a.map", header=replace(HEADER, sessions=()))
    _is_damaged(tmp_path / "a.map")


def test_a_pipe_is_no_map_and_nobody_waits_for_it(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    for command in (["info", path], ["export", path, "-o", tmp_path / "a.ply"]):
        done = CliRunner().invoke(app, ["map", *map(str, command)])
        assert done.exit_code == 1
        assert done.stderr.splitlines() == [
            f"error: cannot read the map {path}: it is a device or a pipe, not a file"
        ]


def test_an_index_of_many_values_is_refused_unread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Text of 3 bytes is a list of 56; a file of this size has no such number of keyframes."""
    _write(tmp_path / "a.map")
    _forge(tmp_path / "a.map", b"[" + b"[]," * 100_000 + b"[]]")
    monkeypatch.setattr(map_file, "load_json", lambda _: pytest.fail("it is read"))
    _is_damaged(tmp_path / "a.map")
