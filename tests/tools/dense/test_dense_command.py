"""`vo dense` on rendered recordings with true depth, and its files as others read them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial import cKDTree
from typer.testing import CliRunner

import vo
from vo.cli.app import app
from vo.recordings.formats.calibration.nerf import read_nerf_poses
from vo.recordings.formats.mesh import read_mesh
from vo.tools.dense import dense as dense_module

POINT = np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk in a room, two cameras, with true depth."""
    folder = tmp_path_factory.mktemp("dense") / "room"
    words: dict[str, Any] = {"world": "room", "motion": "handheld", "camera": "pinhole"}
    vo.synth(folder, seconds=4.0, fps=10.0, depth=True, overrides=["scale=0.5"], **words)
    return folder


@pytest.fixture(scope="module")
def stereo(room: Path) -> Path:
    vo.run(room, room.parent / "stereo", imu=False)
    return room.parent / "stereo"


def points_of(path: Path) -> Any:
    return np.frombuffer(path.read_bytes().split(b"end_header\n", 1)[1], POINT)


def depth_errors(folder: Path, room: Path, scale: float = 1.0) -> Any:
    """Relative errors of all depths that were written."""
    stamps = vo.open(room).stamps_ns  # type: ignore[union-attr]
    errors = []
    for path in sorted((folder / "depth").iterdir()):
        found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) * scale
        true = cv2.imread(str(room / "depth" / f"{stamps[int(path.stem)]}.tiff"), -1)
        known = (found > 0) & np.isfinite(true) & (true > 0)
        errors.append(found[known] / true[known] - 1.0)
    return np.abs(np.concatenate(errors))


def test_two_cameras(room: Path, stereo: Path, tmp_path: Path) -> None:
    options = vo.DenseOptions(far=5.0, depth=True, nerfstudio=tmp_path / "nerf")
    done = vo.dense(stereo, tmp_path / "out", options=options)
    assert done.unit == "m" and done.coverage > 0.5 and done.ground_found
    errors = depth_errors(tmp_path / "out", room)
    assert np.median(errors) < 0.02 and np.mean(errors > 0.1) < 0.05
    cloud = points_of(tmp_path / "out" / "cloud.ply")
    assert len(cloud) == done.points > 10_000
    mesh = read_mesh(tmp_path / "out" / "mesh.ply")
    assert len(mesh.triangles) == done.triangles > 10_000
    # The grid as a map server reads it: occupied where dark, the camera's place is free.
    header = yaml.safe_load((tmp_path / "out" / "map.yaml").read_text())
    image = cv2.imread(str(tmp_path / "out" / header["image"]), cv2.IMREAD_GRAYSCALE)
    occupied = (255 - image.astype(float)) / 255 > header["occupied_thresh"]
    free = (255 - image.astype(float)) / 255 < header["free_thresh"]
    assert occupied.sum() > 100 and free.sum() > 100
    posed = read_nerf_poses(tmp_path / "nerf" / "transforms.json")
    assert len(posed) == done.keyframes
    assert len(list((tmp_path / "nerf" / "images").iterdir())) == done.keyframes
    voxels = np.load(tmp_path / "out" / "voxels.npz")
    centres = (voxels["occupied"] + 0.5) * voxels["edge"]
    summary = json.loads((tmp_path / "out" / "dense.json").read_text())
    ground = np.array(summary["ground_from_world"])
    assert (voxels["ground_from_world"] == ground).all()
    placed = cloud["xyz"] @ ground[:3, :3].T + ground[:3, 3]
    assert cKDTree(centres).query(placed)[0].max() < 0.87 * voxels["edge"] + 1e-4
    assert summary["points"] == done.points and len(summary["ground_from_world"]) == 4


def test_one_camera_is_compared_with_itself(room: Path, tmp_path: Path) -> None:
    vo.run(room, tmp_path / "mono", mode="mono", imu=False)
    result = vo.evaluate(tmp_path / "mono", room, align="sim3")
    options = vo.DenseOptions(depth=True, mesh=False, grid=False)
    done = vo.dense(tmp_path / "mono", options=options)
    assert done.unit == "map units" and done.triangles == 0
    assert b"lengths in map units" in (tmp_path / "mono" / "dense" / "cloud.ply").read_bytes()[:200]
    errors = depth_errors(
        tmp_path / "mono" / "dense", room, result.alignment.reference_from_estimate.scale
    )
    assert np.median(errors) < 0.02 and len(errors) > 50_000


def test_a_depth_camera(room: Path, tmp_path: Path) -> None:
    words: dict[str, Any] = {"world": "room", "motion": "handheld", "camera": "pinhole"}
    vo.synth(tmp_path / "rgbd", to="tum", mono=True, seconds=1.5, overrides=["scale=0.4"], **words)
    vo.run(tmp_path / "rgbd", tmp_path / "run")
    done = vo.dense(tmp_path / "run", options=vo.DenseOptions(grid=False))
    # How far it sees does not depend on the size of its images, here 256x160.
    assert done.unit == "m" and done.coverage > 0.75 and done.far == pytest.approx(8.8)


def test_a_broken_off_call_goes_on_and_gives_the_same_bytes(
    stereo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    vo.dense(stereo, tmp_path / "whole", options=vo.DenseOptions(edge=0.05))

    class Broken(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done >= 4:
            raise Broken

    with pytest.raises(Broken):
        vo.dense(stereo, tmp_path / "parts", options=vo.DenseOptions(edge=0.05), progress=stop)
    kept = list((tmp_path / "parts" / dense_module._WORK).glob("*.npz"))
    assert 3 <= len(kept) <= 8 and not (tmp_path / "parts" / "cloud.ply").exists()
    before = {path.name: path.stat().st_mtime_ns for path in kept}
    seen: list[int] = []

    def look(done: int, total: int) -> None:
        if not seen:
            now = {p.name: p.stat().st_mtime_ns for p in (tmp_path / "parts").rglob("*.npz")}
            assert before.items() <= now.items()
        seen.append(done)

    vo.dense(stereo, tmp_path / "parts", options=vo.DenseOptions(edge=0.05), progress=look)
    for name in ("cloud.ply", "mesh.ply", "map.pgm", "above.png"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert not (tmp_path / "parts" / dense_module._WORK).exists()


def test_a_cloud_in_e57(stereo: Path, tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    options = vo.DenseOptions(edge=0.05, mesh=False, grid=False, cloud=tmp_path / "a.e57")
    done = vo.dense(stereo, tmp_path / "out", options=options)
    points = pye57.E57(str(tmp_path / "a.e57")).read_scan(
        0, colors=True, ignore_missing_fields=True
    )
    cloud = points_of(tmp_path / "out" / "cloud.ply")
    assert len(cloud) == done.points
    found = np.column_stack([points[f"cartesian{axis}"] for axis in "XYZ"])
    assert np.abs(found - cloud["xyz"]).max() < 1e-5
    assert (points["colorRed"] == cloud["rgb"][:, 0]).all()


def test_las_and_rerun(stereo: Path, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("rerun")
    outputs = {"cloud": tmp_path / "a.laz", "rrd": tmp_path / "a.rrd"}
    done = vo.dense(stereo, tmp_path / "out", options=vo.DenseOptions(edge=0.05, **outputs))
    points = laspy.read(tmp_path / "a.laz")
    assert points.header.point_count == done.points
    cloud = points_of(tmp_path / "out" / "cloud.ply")
    assert np.abs(np.column_stack([points.x, points.y, points.z]) - cloud["xyz"]).max() < 1e-3
    assert (np.asarray(points.red) // 257 == cloud["rgb"][:, 0]).all()
    assert (tmp_path / "a.rrd").stat().st_size > 10_000


def test_the_command_and_the_report(stereo: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(stereo, tmp_path / "run"))
    call = ["dense", str(run), "--no-mesh", "--band", "0.1,1", "--cell", "0.1", "--json"]
    result = CliRunner().invoke(app, call)
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    assert said["output"] == str(run / "dense") and said["triangles"] == 0
    pytest.importorskip("matplotlib")
    page = vo.report(run, images=False).read_text()
    assert page.count('alt="Cloud of points') == 2
    with (run / "poses.csv").open("a") as file:  # a later run into the same folder
        file.write("\n")
    assert 'alt="Cloud of points' not in vo.report(run, images=False).read_text()


def test_an_export_with_masks_and_a_colmap_model(room: Path, tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    vo.run(room, tmp_path / "run", imu=False, end=20, overrides=["masks.ignore=0,100,320,100"])
    folders = ["--nerfstudio", str(tmp_path / "nerf"), "--colmap", str(tmp_path / "colmap")]
    result = CliRunner().invoke(app, ["export", str(tmp_path / "run"), *folders])
    assert result.exit_code == 0, result.output
    frames = json.loads((tmp_path / "nerf" / "transforms.json").read_text())["frames"]
    mask = cv2.imread(str(tmp_path / "nerf" / frames[0]["mask_path"]), cv2.IMREAD_GRAYSCALE)
    assert not mask[101:].any() and mask[:80].mean() > 200
    model = pycolmap.Reconstruction(str(tmp_path / "colmap" / "sparse" / "0"))
    names = {image.name for image in model.images.values()}
    assert names == {Path(each["file_path"]).name for each in frames}
    assert {path.name for path in (tmp_path / "colmap" / "images").iterdir()} == names
    assert {path.stem for path in (tmp_path / "colmap" / "masks").iterdir()} == names
    assert len(model.points3D) == len(points_of(tmp_path / "nerf" / "cloud.ply")) > 1000
    nothing = CliRunner().invoke(app, ["export", str(tmp_path / "run")])
    assert nothing.exit_code == 1 and "--nerfstudio DIR or --colmap DIR" in nothing.output


def test_a_run_that_goes_on_to_its_cloud(room: Path, tmp_path: Path) -> None:
    call = ["run", str(room), "-o", str(tmp_path / "a"), "--end", "20", "--no-imu", "--dense"]
    result = CliRunner().invoke(app, call)
    assert result.exit_code == 0, result.output
    assert "cloud " in result.stdout and (tmp_path / "a" / "dense" / "mesh.ply").is_file()
    again = CliRunner().invoke(app, ["run", str(room), "-o", str(tmp_path / "a"), "--end", "20"])
    assert again.exit_code == 0 and (tmp_path / "a" / "dense" / "mesh.ply").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--band", "high"], "--band is high; give two heights, such as 0.15,1.8"),
        (["--band", "2,1"], "--band is 2 to 1; give a lower and a higher height"),
        (["--edge", "0"], "--edge is 0; give a length above 0"),
        (["--far", "nan"], "--far is nan; give a length above 0"),
        (["--segment", "7"], "has no segment 7; it has 0"),
        (["--cloud", "a.txt"], "give a name in .las, .laz or .e57"),
        (["/nowhere"], "/nowhere"),
        (["-o", "{room}"], "choose another"),
        (["--rrd", "{stereo}/poses.csv"], "is an input and would be replaced"),
    ],
)
def test_what_cannot_be_is_refused(
    room: Path, stereo: Path, tmp_path: Path, words: list[str], message: str
) -> None:
    words = [word.format(room=room / "mav0", stereo=stereo) for word in words]
    result = CliRunner().invoke(app, ["dense", str(stereo), "-o", str(tmp_path / "x"), *words])
    assert result.exit_code == 1 and message in " ".join(result.output.split())
    assert result.output.count("\n") == 1


def test_a_run_with_too_little_to_see(room: Path, stereo: Path, tmp_path: Path) -> None:
    vo.run(room, tmp_path / "short", imu=False, end=2)
    with pytest.raises(vo.SourceError, match="no depth is confirmed by another keyframe"):
        vo.dense(tmp_path / "short")
    run = Path(shutil.copytree(stereo, tmp_path / "run"))
    rows = [row.split(",") for row in (run / "poses.csv").read_text().splitlines()]
    at = rows[0].index("keyframe")
    table = [",".join([*row[:at], "0", *row[at + 1 :]]) for row in rows[1:]]
    (run / "poses.csv").write_text("\n".join([",".join(rows[0]), *table]) + "\n")
    with pytest.raises(vo.SourceError, match="has no keyframe"):
        vo.dense(run)


def test_a_folder_without_a_run(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["dense", str(tmp_path)])
    assert result.exit_code == 1 and "has no summary.json" in " ".join(result.output.split())


def test_another_recording_is_refused(stereo: Path, tmp_path: Path) -> None:
    words: dict[str, Any] = {"world": "room", "motion": "handheld", "camera": "pinhole"}
    vo.synth(tmp_path / "other", seconds=2.0, fps=5.0, overrides=["scale=0.5"], **words)
    with pytest.raises(vo.SourceError, match="other is not the recording of .*stereo"):
        vo.dense(stereo, tmp_path / "out", tmp_path / "other")


def test_a_cut_off_line_of_poses_is_left_out(stereo: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(stereo, tmp_path / "run"))
    whole = (run / "poses.csv").read_text().splitlines()
    (run / "poses.csv").write_text("\n".join(whole[:30])[:-40])
    words = ["dense", str(run), "-o", str(tmp_path / "x"), "--no-mesh", "--no-grid"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    keyframes = sum(line.split(",")[3] == "1" for line in whole[1:29])
    assert json.loads((tmp_path / "x" / "dense.json").read_text())["keyframes"] == keyframes
