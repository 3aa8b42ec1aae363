from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from vo.base.types import Camera
from vo.cli.app import app
from vo.engine.mapping.keyframe import FrameId
from vo.engine.maps.map_file import MapHeader, write_map
from vo.engine.places.encoding import encode_place
from vo.engine.places.records import PATCH_PX, Place, PlaceKey, PlaceLandmarks, RegisteredKeyframes


def _map(path: Path, *, is_metric: bool = True, metric_worlds: tuple[int, ...] = ()) -> Path:
    """Two keyframes; 2 of the 3 landmarks of the second are in the first too.

    They are in two worlds if one of these is said to be metric.
    """
    keys = PlaceKey(0, 0), PlaceKey(0, 1)
    encoded = []
    for n, key in enumerate(keys):
        landmarks = PlaceLandmarks(
            id=np.arange(n, n + 3),
            xyz=np.eye(3, dtype=np.float32),
            xy=np.zeros((3, 2), np.float32),
            sigma=np.full(3, 0.01, np.float32),
            descriptor=np.zeros((3, 32), np.uint8),
            octave=np.zeros(3, np.int32),
            angle=np.zeros(3, np.float32),
            patch=np.full((3, PATCH_PX, PATCH_PX), 100 + n, np.uint8),
        )
        place = Place(
            *(key, FrameId(n, n, 0), is_metric, np.eye(4), np.eye(6)),
            *(np.zeros((4, 32), np.uint8), landmarks, np.zeros((4, 4), np.uint8)),
        )
        encoded.append((key, encode_place(place)))
    poses = np.stack([np.eye(4)] * 2)
    poses[1, 0, 3] = 5.0
    worlds = np.array([0, len(metric_worlds)])
    placed = RegisteredKeyframes(
        keys, worlds, poses, np.array([1.0, 2.0]), np.zeros((2, 6, 6)), rejected=()
    )
    camera = Camera(64, 48, 50, 50, 32, 24)
    write_map(path, MapHeader(camera, "ab", ("house",), metric_worlds), encoded, placed)
    return path


def test_info_lists_what_is_in_a_map(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["map", "info", str(_map(tmp_path / "a.map")), "--json"])
    result = json.loads(done.stdout)
    assert done.exit_code == 0
    assert (result["keyframes"], result["loops"], result["observations"]) == (2, 0, 6)
    assert result["worlds"] == [{"world": 0, "keyframes": 2, "length_unit": "m"}]
    assert result["sessions"] == ["house"]
    assert result["metric_worlds"] == []


def test_info_says_which_worlds_of_one_camera_are_in_metres(tmp_path: Path) -> None:
    path = _map(tmp_path / "a.map", is_metric=False, metric_worlds=(1,))
    done = CliRunner().invoke(app, ["map", "info", str(path), "--json"])
    result = json.loads(done.stdout)
    assert [row["length_unit"] for row in result["worlds"]] == ["map units", "m"]
    assert result["metric_worlds"] == [1]
    lines = CliRunner().invoke(app, ["map", "info", str(path)]).stdout.splitlines()
    assert "world 0: 1 keyframes, lengths in map units" in lines
    assert "world 1: 1 keyframes, lengths in m" in lines


def test_export_writes_each_landmark_once(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    done = CliRunner().invoke(
        app, ["map", "export", str(_map(tmp_path / "a.map")), "-o", str(path)]
    )
    assert done.stdout.startswith("4 points of world 0")
    header, rows = path.read_bytes().split(b"end_header\n")
    assert b"element vertex 4" in header
    points = np.frombuffer(rows, np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)]))
    # Those of the second keyframe, in its pose and scale, then the one that only the first has.
    assert points["xyz"].tolist() == [[7, 0, 0], [5, 2, 0], [5, 0, 2], [1, 0, 0]]
    assert points["rgb"][:, 0].tolist() == [101, 101, 101, 100]


def test_a_damaged_map_is_one_line(tmp_path: Path) -> None:
    path = _map(tmp_path / "a.map")
    path.write_bytes(path.read_bytes()[:-100])
    done = CliRunner().invoke(app, ["map", "info", str(path)])
    assert done.exit_code == 1
    assert done.stderr.splitlines() == [
        f"error: the map {path} is damaged or cut off; use a copy, or make it anew"
    ]
