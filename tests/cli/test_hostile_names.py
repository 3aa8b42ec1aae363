"""Names in files that would lead out of a folder where a path is made of them."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path

import bag_logs
import camera_logs
import layouts
import numpy as np
import pytest
import yaml
from place_samples import make_place, random_descriptors
from typer.testing import CliRunner

from vo.base.types import Camera
from vo.cli.app import app
from vo.engine.maps.map_file import MapHeader, write_map
from vo.engine.places.encoding import encode_place
from vo.engine.places.records import RegisteredKeyframes

NAMES = ["../../escaped", "/{root}/escaped", "..", "-o", "a\nb\x1b[2J", "a/../../../escaped", "~/x"]
KEPT = "not to be touched"


def vo(*words: object) -> str:
    """The output of a command; a traceback is an error of the test."""
    result = CliRunner().invoke(app, list(map(str, words)))
    assert result.exception is None or isinstance(result.exception, SystemExit), words
    assert "\x1b" not in result.output
    return result.output


def _log(root: Path, name: str) -> None:
    """Topics and frames of that name."""
    parts = (
        camera_logs.images(f"/{name}/image", name),
        camera_logs.calibration(f"/{name}/info", name),
    )
    log = camera_logs.log(root, *parts)
    vo("info", log, "--picture", root / "out.png")
    vo("convert", log, root / "out")
    vo("run", log, "-o", root / "run", "--colmap", root / "model", "--ply", root / "a.ply", "-q")


def _bag_parts(root: Path, name: str) -> None:
    """A bag whose list of files has it."""
    bag_logs.write_bag2(root / "bag", layouts.log_messages())
    file = root / "bag" / "metadata.yaml"
    about = yaml.safe_load(file.read_text("utf-8"))
    about["rosbag2_bagfile_information"]["relative_file_paths"] = [f"{name}.db3"]
    file.write_text(yaml.safe_dump(about), encoding="utf-8")
    sqlite3.connect(root.parents[1] / "escaped.db3").close()
    assert "escaped.db3 (" not in vo("info", root / "bag")


def _images(root: Path, name: str) -> None:
    """Images in a table, in the poses of NeRF, and in a model of COLMAP."""
    for each in ("rgb.txt", "times.txt"):
        layouts.write_text(root / "table" / each, f"0.0 {name}.png\n0.1 {name}.png\n")
        vo("run", root / "table", "-o", root / "run", "--colmap", root / "model", "-q")
    frames = [{"file_path": name, "transform_matrix": np.eye(4).tolist()}]
    layouts.write_text(root / "nerf" / "transforms.json", json.dumps({"w": 9, "frames": frames}))
    vo("convert", root / "nerf", root / "out")


def _manifest(root: Path, name: str) -> None:
    rows = [{"source": "missing.mcap", "name": name, "tags": {name: name}}]
    layouts.write_text(root / "jobs.json", json.dumps(rows))
    vo("batch", "--manifest", root / "jobs.json", "-o", root / "batch", "--retries", "0", "-q")


def _session(root: Path, name: str) -> None:
    """The recording of a session in a map."""
    place = make_place(0, random_descriptors(np.random.default_rng(0), 40))
    rows = np.zeros(1, np.int64), np.eye(4)[None], np.ones(1), np.zeros((1, 6, 6))
    header = MapHeader(Camera(320, 240, 200.0, 201.0, 160.5, 120.5), "00e2", (name,))
    placed = RegisteredKeyframes((place.key,), *rows, rejected=())
    write_map(root / "a.vomap", header, [(place.key, encode_place(place))], placed, [], [])
    vo("map", "info", root / "a.vomap")
    vo("map", "export", root / "a.vomap", "-o", root / "a.ply")
    vo("map", "merge", root / "a.vomap", root / "a.vomap", "-o", root / "b.vomap")


def _objects(root: Path, name: str) -> None:
    layouts.write_image(root / "a.png", layouts.image(0))
    vo("recognize", "add", name, root / "a.png", "--database", root / "a.vodb")
    vo("recognize", "list", "--database", root / "a.vodb")
    vo("recognize", "remove", name, "--database", root / "a.vodb")


def _models(root: Path, name: str) -> None:
    for action in ("fetch", "verify", "path"):
        vo("models", action, name)
    assert "escaped" not in vo("run", root, "--set", f"features.detector={name}").split("error")[0]


def _summary(root: Path, name: str) -> None:
    """The source of an earlier run, of which a report is made."""
    layouts.write_folder(root / "walk")
    vo("run", root / "walk", "-o", root / "run", "-q")
    file = root / "run" / "summary.json"
    summary = json.loads(file.read_text("utf-8"))
    file.write_text(json.dumps(summary | {"source": name}), encoding="utf-8")
    vo("report", root / "run", "-o", root / "r.html", "--plots", root / "plots")
    vo("view", root / "run", "--json")


PLACES = [_log, _bag_parts, _images, _manifest, _session, _objects, _models, _summary]


@pytest.fixture
def root(tmp_path: Path) -> Iterator[Path]:
    """A folder two levels below one whose files are counted afterwards."""
    inside = tmp_path / "a" / "b"
    inside.mkdir(parents=True)
    for folder in (tmp_path, tmp_path / "a"):
        (folder / "escaped").mkdir()
        (folder / "escaped" / "file").write_text(KEPT, encoding="utf-8")
    yield inside
    for folder in (tmp_path, tmp_path / "a"):
        assert (folder / "escaped" / "file").read_text("utf-8") == KEPT
        assert [path.name for path in (folder / "escaped").iterdir()] == ["file"]
    assert {path.name for path in (tmp_path / "a").iterdir()} <= {"b", "escaped", "escaped.db3"}
    assert {path.name for path in tmp_path.iterdir()} == {"a", "escaped"}


@pytest.mark.parametrize("place", PLACES, ids=lambda place: place.__name__)
def test_no_name_leads_out_of_a_folder(
    place: Callable[[Path, str], None], root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(root)
    for number, name in enumerate(NAMES):
        folder = root / str(number)
        folder.mkdir()
        place(folder, name.format(root=root.parent.parent))
    assert {path.name for path in root.iterdir()} == set(map(str, range(len(NAMES))))
