"""Matches of a folder as CSV, NPZ, HDF5 and COLMAP database, read as others read them."""

from __future__ import annotations

import csv
import json
import sqlite3
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from two_images import CAMERA, MOTION, layered_pair
from typer.testing import CliRunner, Result

from vo.base.types import Floats
from vo.cli.app import app

MAX_IMAGE_ID = 2**31 - 1
CALIBRATION = "cam0: {resolution: [320, 240], intrinsics: [300, 300, 159.5, 119.5]}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three images, of which the second and third show the scene from the same place."""
    place = tmp_path / "photos"
    place.mkdir()
    first, second = layered_pair()
    for name, image in (("b.png", first), ("c.png", second), ("d.png", second[:, :300])):
        cv2.imwrite(str(place / name), image)
    return place


def match(*words: object) -> Result:
    return CliRunner().invoke(app, ["match", *map(str, words)], catch_exceptions=False)


def arrays_of(path: Path) -> dict[str, Any]:
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def blob(data: bytes, kind: str, columns: int) -> Any:
    return np.frombuffer(data, kind).reshape(-1, columns)


def test_all_pairs_of_a_folder_agree_in_all_formats(folder: Path, tmp_path: Path) -> None:
    out = [tmp_path / f"out/m{suffix}" for suffix in (".csv", ".npz", ".db")]
    result = match(folder, *(word for path in out for word in ("-o", path)), "--json")
    assert result.exit_code == 0, result.output
    pairs = json.loads(result.stdout)["pairs"]
    assert [(p["image_a"], p["image_b"]) for p in pairs] == [
        ("b.png", "c.png"),
        ("b.png", "d.png"),
        ("c.png", "d.png"),
    ]
    with out[0].open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    arrays = arrays_of(out[1])
    database = sqlite3.connect(out[2])
    for number, pair in enumerate(pairs):
        a, b = pair["image_a"], pair["image_b"]
        of_pair = [row for row in rows if (row["image_a"], row["image_b"]) == (a, b)]
        matches, inlier = arrays[f"matches/{a}/{b}"], arrays[f"inlier/{a}/{b}"]
        assert len(of_pair) == len(matches) == pair["matches"]
        assert sum(int(row["inlier"]) for row in of_pair) == inlier.sum() == pair["inliers"]
        xy = arrays[f"keypoints/{b}"][matches[:, 1]]
        assert np.allclose([[float(r["x_b"]), float(r["y_b"])] for r in of_pair], xy, atol=1e-3)
        ids = ((1, 2), (1, 3), (2, 3))[number]
        pair_id = MAX_IMAGE_ID * ids[0] + ids[1]
        count, data = database.execute(
            "SELECT rows, data FROM matches WHERE pair_id=?", (pair_id,)
        ).fetchone()
        assert count == len(matches) and (blob(data, "<u4", 2) == matches).all()
        count, data = database.execute(
            "SELECT rows, data FROM two_view_geometries WHERE pair_id=?", (pair_id,)
        ).fetchone()
        assert count == pair["inliers"] and (blob(data, "<u4", 2) == matches[inlier]).all()
    (data,) = database.execute("SELECT data FROM keypoints WHERE image_id=3").fetchone()
    assert np.allclose(blob(data, "<f4", 2), arrays["keypoints/d.png"] + 0.5)
    database.close()


def epipolar_px(fundamental: Floats, first: Floats, second: Floats) -> Floats:
    """Distances (N,) of second pixels from the lines of the first."""
    ones = np.ones((len(first), 1))
    lines = np.hstack([first, ones]) @ fundamental.T
    along = (np.hstack([second, ones]) * lines).sum(axis=1)
    return np.asarray(abs(along) / np.linalg.norm(lines[:, :2], axis=1))


@pytest.mark.parametrize("order", [("b.png", "c.png"), ("c.png", "b.png")])
def test_colmap_reads_keypoints_matches_and_geometry(
    order: tuple[str, str], folder: Path, tmp_path: Path
) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    pairs, out = tmp_path / "pairs.txt", tmp_path / "m.db"
    # The first line fixes the ids: b is 1, c is 2.
    pairs.write_text(f"# pairs\nb.png d.png\nc.png d.png\n{order[0]}\t{order[1]}\n", "utf-8")
    assert match(folder, "--pairs", pairs, "-o", out).exit_code == 0
    database = pycolmap.Database.open(str(out))
    names = {image.name: image.image_id for image in database.read_all_images()}
    first, second = sorted((names["b.png"], names["c.png"]))
    name = {number: name for name, number in names.items()}
    keypoints = [np.asarray(database.read_keypoints(each)) for each in (first, second)]
    assert len(database.read_all_cameras()) == 3
    found = database.read_two_view_geometry(first, second)
    rows = np.asarray(found.inlier_matches)
    assert len(rows) > 60
    assert (np.asarray(database.read_matches(first, second))[:, 0] < len(keypoints[0])).all()
    assert found.config == pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED
    assert name[first] == "b.png" or order == ("c.png", "b.png")
    errors = epipolar_px(found.F, keypoints[0][rows[:, 0]], keypoints[1][rows[:, 1]])
    assert np.median(errors) < 0.5
    database.close()


def test_colmap_reads_the_motion_of_calibrated_images(folder: Path, tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    (folder / "d.png").unlink()
    calibration, out = tmp_path / "calibration.yaml", tmp_path / "m.db"
    calibration.write_text(CALIBRATION, encoding="utf-8")
    assert match(folder, "--calibration", calibration, "-o", out).exit_code == 0
    database = pycolmap.Database.open(str(out))
    (camera,) = database.read_all_cameras()
    assert list(camera.params) == [300, 300, 160, 120] and camera.has_prior_focal_length
    pose = database.read_two_view_geometry(1, 2).cam2_from_cam1.matrix()
    assert np.abs(pose[:, :3] - MOTION[:3, :3]).max() < 0.01
    assert pose[:, 3] @ MOTION[:3, 3] / np.linalg.norm(MOTION[:3, 3]) > 0.99
    database.close()
    assert CAMERA.fx == 300


def test_hdf5_has_the_arrays_of_npz(folder: Path, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    out = tmp_path / "m.h5", tmp_path / "m.npz"
    assert match(folder, "-o", out[0], "-o", out[1], "--window", 1).exit_code == 0
    arrays = arrays_of(out[1])
    assert "matches/b.png/d.png" not in arrays
    with h5py.File(out[0]) as file:
        for name in arrays:
            assert (file[name][()] == arrays[name]).all()


def test_images_that_cannot_be_read_are_left_out(folder: Path, tmp_path: Path) -> None:
    (folder / "a.png").write_bytes(b"no image")
    out = tmp_path / "m.npz"
    result = match(folder, "-o", out, "-q")
    assert result.exit_code == 0
    assert "a.png" in result.stderr and "left out" in result.stderr
    assert {name for name in arrays_of(out) if name.startswith("keypoints")} == {
        f"keypoints/{name}.png" for name in "bcd"
    }


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["."], "the name"),
        (["photos", "-o", "m.txt"], "must end in .csv"),
        (["photos", "-o", "other.db"], "is a database of others"),
        (["photos", "-o", "m.csv", "-o", "m.csv"], "given twice"),
        (["photos", "--picture", "m.png"], "--picture needs two images"),
        (["photos/b.png"], "give a second one"),
        (["photos/b.png", "photos/c.png", "--window", "2"], "--window needs one folder"),
        (["photos/b.png", "photos/c.png", "--best", "2"], "--best needs --picture"),
        (["photos/b.png", "photos/c.png", "--keypoints"], "--keypoints needs --json"),
        (["photos/b.png", "photos/c.png", "--warp", "w.png", "--model", "f"], "a homography"),
        (["photos/b.png", "photos/c.png", "--roi-a", "0,0,0,9"], "0 x 9 pixels"),
        (["photos/b.png", "photos/c.png", "--roi-b", "right:0,0,9,9"], "names a camera"),
        (["photos", "--pairs", "wrong.txt"], "wrong.txt:1 is 'b.png'"),
        (["photos", "--pairs", "none.txt"], "none.txt: No such file"),
    ],
)
def test_wrong_input_is_one_line(
    words: list[str], message: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder.parent)
    Path("wrong.txt").write_text("b.png\n", encoding="utf-8")
    with sqlite3.connect("other.db") as database:
        database.execute("CREATE TABLE mine (a)")
    database.close()
    result = match(*words)
    assert result.exit_code == 1
    lines = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    if message != "the name":
        assert len(lines) == 1 and message in lines[0]
    else:
        assert "no images" in lines[0]
