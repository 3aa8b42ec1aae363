"""COLMAP models, PLY and MCAP files, read back with other libraries."""

from __future__ import annotations

import errno
import json
import logging
import os
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import exact_run
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import CliRunner

from vo.base.config import load_config
from vo.base.errors import OutputError
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Camera, Rig, Trajectory
from vo.cli.app import app
from vo.outputs.recorders.colmap import ColmapRecorder, ImageFolder
from vo.outputs.recorders.durable_file import DurableFile
from vo.outputs.recorders.exports import Exports, SeveralRecorders
from vo.outputs.recorders.map_spool import Model, PointTracks
from vo.outputs.recorders.mcap_recorder import McapRecorder
from vo.outputs.recorders.ply import PlyRecorder
from vo.outputs.recorders.reconstruction import Reconstruction
from vo.outputs.recorders.recorder import Findings, LoopClosures, Recorder
from vo.recordings.formats.trajectory import read_tum
from vo.runs.run_recording import run

RIG = Rig(exact_run.PINHOLE)
RUN_FRAMES = 12


def record(recorder: Recorder, camera: Camera = exact_run.PINHOLE) -> None:
    recorder.begin("a name", RIG, None)
    for frame in range(exact_run.FRAMES):
        exact_run.record(recorder, frame, camera)
    recorder.finish(exact_run.smoothed(), exact_run.smoothed())


def colmap_errors(model: Any) -> np.ndarray:
    errors = []
    for image in model.images.values():
        camera, cam_from_world = model.cameras[image.camera_id], image.cam_from_world()
        for seen in image.points2D:
            assert seen.has_point3D()
            xyz = cam_from_world * model.points3D[seen.point3D_id].xyz
            errors.append(np.linalg.norm(camera.img_from_cam(xyz) - seen.xy))
    return np.array(errors)


def all_points(model: Model) -> PointTracks:
    """The points of a model; tracks are left out."""
    parts = list(model.points())
    number = np.concatenate([part.number for part in parts])
    order = np.argsort(number)
    assert (number[order] == np.arange(model.point_count)).all()
    values = ("xyz", "grey", "error_px")
    xyz, grey, error = (np.concatenate([getattr(p, v) for p in parts])[order] for v in values)
    none = np.empty(0, dtype=np.int64)
    return PointTracks(number[order], xyz, grey, error, none, none, none)


def read_ply(path: Path) -> np.ndarray:
    header, _, body = path.read_bytes().partition(b"end_header\n")
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\n")
    rows = np.frombuffer(body, dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    assert f"element vertex {len(rows)}\n".encode() in header
    return rows


def read_mcap(path: Path) -> dict[str, list[Any]]:
    messages = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None and channel.message_encoding == "protobuf"
            messages[channel.topic].append((message.log_time, decoded))
    return messages


def test_the_colmap_camera_has_the_estimated_distortion(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    found = replace(exact_run.PINHOLE, distortion_model="radtan", distortion=(0.01, 0.0, 0.0, 0.0))
    recorder = ColmapRecorder(tmp_path)
    recorder.begin("a name", RIG, None)
    for frame in range(exact_run.FRAMES):
        exact_run.record(recorder, frame, exact_run.PINHOLE if frame < 2 else found)
    recorder.finish(exact_run.smoothed(), exact_run.smoothed())
    (camera,) = pycolmap.Reconstruction(str(tmp_path / "sparse" / "0")).cameras.values()
    assert camera.model.name == "OPENCV"
    assert camera.params[4] == pytest.approx(0.01)


@pytest.mark.parametrize("lens", exact_run.LENSES)
def test_colmap_reads_an_exact_model(lens: str, tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    record(ColmapRecorder(tmp_path), exact_run.LENSES[lens])
    model = pycolmap.Reconstruction(str(tmp_path / "sparse" / "0"))
    expected = {
        "pinhole": "PINHOLE",
        "radtan4": "OPENCV",
        "radtan5": "FULL_OPENCV",
        "equidistant": "OPENCV_FISHEYE",
        "double_sphere": "PINHOLE",
    }
    assert [camera.model_name for camera in model.cameras.values()] == [expected[lens]]
    assert model.num_images() == exact_run.FRAMES
    errors = colmap_errors(model)
    assert len(errors) > 1000
    assert errors.max() < 0.002  # pixels are written with three decimals
    found = np.array([point.xyz for point in model.points3D.values()])
    true = exact_run.points()
    nearest = np.abs(found[:, None] - true[None]).max(axis=2).min(axis=1)
    assert nearest.max() < 1e-9
    for image in model.images.values():
        number = int(image.name.removeprefix("frame_").removesuffix(".png"))
        expected_centre = exact_run.pose(number)[:3, 3]
        np.testing.assert_allclose(image.projection_center(), expected_centre, atol=1e-9)
        picture = cv2.imread(str(tmp_path / "images" / image.name), cv2.IMREAD_GRAYSCALE)
        if lens != "double_sphere":
            shown = exact_run.view(number, exact_run.LENSES[lens]).image0
            np.testing.assert_array_equal(picture, shown)


def test_landmarks_outside_of_the_map_are_kept_and_outliers_removed() -> None:
    reconstruction = Reconstruction()
    for frame in range(exact_run.FRAMES):
        snapshot = exact_run.snapshot(frame)
        assert snapshot.landmarks is not None
        xyz = snapshot.landmarks.xyz.copy()
        xyz[snapshot.landmarks.ids == 200] += 1.0  # a landmark at a wrong position
        landmarks = replace(snapshot.landmarks, xyz=xyz)
        reconstruction.add(exact_run.estimate(frame), replace(snapshot, landmarks=landmarks))
    (model,) = reconstruction.models(exact_run.smoothed())
    points = all_points(model)
    seen = np.bincount(
        np.concatenate(
            [exact_run.sightings(k, exact_run.PINHOLE).ids for k in range(exact_run.FRAMES)]
        ),
        minlength=exact_run.POINTS,
    )
    expected = np.setdiff1d(np.flatnonzero(seen >= 2), [200])
    np.testing.assert_allclose(points.xyz, exact_run.points()[expected], atol=1e-9)
    np.testing.assert_array_equal(points.grey, expected % 256)
    assert points.error_px.max() < 1e-9


def test_points_move_with_the_final_path() -> None:
    reconstruction = Reconstruction()
    for frame in range(exact_run.FRAMES):
        reconstruction.add(exact_run.estimate(frame), exact_run.snapshot(frame))
    move = make_transform(so3_exp(np.array([0.1, 0.4, -0.2])), np.array([3.0, -1.0, 2.0]))
    path = exact_run.smoothed()
    (before,) = reconstruction.models(path)
    (after,) = reconstruction.models(Trajectory(path.stamps_ns, move @ path.world_from_cam))
    moved = all_points(before).xyz @ move[:3, :3].T + move[:3, 3]
    np.testing.assert_allclose(all_points(after).xyz, moved, atol=1e-9)


@pytest.mark.parametrize("is_merged", [False, True])
def test_each_world_is_a_separate_model(is_merged: bool, tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    (tmp_path / "sparse" / "7").mkdir(parents=True)
    (tmp_path / "sparse" / "7" / "images.txt").write_text("of an earlier run")
    recorder = ColmapRecorder(tmp_path)
    recorder.begin("a", RIG, None)
    for frame in range(3):
        exact_run.record(recorder, frame)
    for frame in range(8, exact_run.FRAMES):  # the map is a new one
        estimate, snapshot = exact_run.estimate(frame, segment=1), exact_run.snapshot(frame)
        assert snapshot.landmarks is not None
        kept = tuple(s for s in snapshot.landmarks.sightings if s.frame_index >= 8)
        keyframes = tuple(k for k in estimate.keyframes if k.frame_index >= 8)
        snapshot = replace(snapshot, landmarks=replace(snapshot.landmarks, sightings=kept))
        recorder.record(replace(estimate, keyframes=keyframes), lambda snapshot=snapshot: snapshot)
    recorder._write_map(None, Findings())  # as during the run
    closures = LoopClosures((), (), exact_run.smoothed(), {1: 0}, {}) if is_merged else None
    recorder.finish(exact_run.smoothed(), exact_run.smoothed(), Findings(closures=closures))
    names = [path.name for path in sorted((tmp_path / "sparse").iterdir())]
    assert names == (["0"] if is_merged else ["0", "1"])
    lines = (tmp_path / "sparse" / "0" / "images.txt").read_text().splitlines()
    after = range(8, exact_run.FRAMES)
    frames = [*range(3), *after] if is_merged else after
    assert [line.split()[-1] for line in lines[::2]] == [f"frame_{n:06d}.png" for n in frames]


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("sparse/0/mine.txt", "notes"),
        ("sparse/1/cameras.bin", "binary"),
        ("sparse/0/cameras.txt", "# Camera list with one line of data per camera:\n"),
        ("images/photo.png", "pixels"),
    ],
)
def test_models_and_images_of_others_are_refused(file: str, content: str, tmp_path: Path) -> None:
    (tmp_path / file).parent.mkdir(parents=True)
    (tmp_path / file).write_text(content)
    with pytest.raises(OutputError, match="not of an earlier run"):
        ColmapRecorder(tmp_path).begin("a", RIG, None)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [tmp_path / file]
    assert (tmp_path / file).read_text() == content


def test_images_keep_their_names_and_colours(tmp_path: Path) -> None:
    recorded, written = tmp_path / "recorded", tmp_path / "written"
    for folder in (recorded, recorded / "other", written):
        folder.mkdir()
    colour = np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    for name in ("a 1.png", "other/a 1.png"):
        assert cv2.imwrite(str(recorded / name), colour)
    images, grey = ImageFolder(written), exact_run.view(0, exact_run.PINHOLE).image0
    found = []
    for frame, name in enumerate(["a 1.png", "other/a 1.png", "missing.png", "a 1.png"]):
        found.append(images.add(frame, recorded / name, grey, is_recorded=frame < 3))
    assert found == ["a_1.png", "a_1_000001.png", "missing.png", "a_1_000003.png"]
    assert (written / "a_1.png").read_bytes() == (recorded / "a 1.png").read_bytes()
    for name in found[2:]:
        picture = cv2.imread(str(written / name), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(picture, grey)


@pytest.mark.parametrize("name", ["images", "sparse", "sparse/0"])
def test_a_folder_of_a_model_that_is_a_link_is_refused(name: str, tmp_path: Path) -> None:
    elsewhere, link = tmp_path / "elsewhere", tmp_path / "model" / name
    elsewhere.mkdir()
    link.parent.mkdir(parents=True)
    link.symlink_to(elsewhere)
    with pytest.raises(OutputError, match="choose another `colmap`"):
        ColmapRecorder(tmp_path / "model").begin("a", RIG, None)
    assert link.is_symlink() and not list(elsewhere.iterdir())


def test_images_of_the_recording_are_never_overwritten(tmp_path: Path) -> None:
    image = exact_run.view(0, exact_run.PINHOLE).image0
    (tmp_path / "a.png").write_bytes(b"mine")
    with pytest.raises(OSError, match="the images of the recording"):
        ImageFolder(tmp_path / ".." / tmp_path.name).add(
            0, tmp_path / "a.png", image, is_recorded=False
        )
    assert (tmp_path / "a.png").read_bytes() == b"mine"


def test_ply_holds_the_points_in_grey(tmp_path: Path) -> None:
    record(PlyRecorder(tmp_path / "new" / "map.ply"))
    rows = read_ply(tmp_path / "new" / "map.ply")
    assert len(rows) > 250
    ids = np.argmin(np.linalg.norm(rows["xyz"][:, None] - exact_run.points()[None], axis=2), axis=1)
    np.testing.assert_allclose(rows["xyz"], exact_run.points()[ids], atol=1e-5)
    np.testing.assert_array_equal(rows["rgb"], np.repeat((ids % 256)[:, None], 3, axis=1))


def test_mcap_opens_with_the_official_decoders(tmp_path: Path) -> None:
    record(McapRecorder(tmp_path / "a.mcap"), exact_run.LENSES["radtan4"])
    messages = read_mcap(tmp_path / "a.mcap")
    for topic in ("/tf", "/pose", "/image", "/calibration", "/features", "/map"):
        assert [time for time, _ in messages[topic]] == exact_run.smoothed().stamps_ns.tolist(), (
            topic
        )
    last = messages["/pose"][-1][1]
    np.testing.assert_allclose(
        [last.pose.position.x, last.pose.position.y, last.pose.position.z],
        exact_run.pose(exact_run.FRAMES - 1)[:3, 3],
    )
    frames = [(t.parent_frame_id, t.child_frame_id) for t in messages["/tf"][3][1].transforms]
    assert frames == [("cam0", "cam0_image"), ("world", "cam0")]
    assert len(messages["/path"][-1][1].poses) == exact_run.FRAMES
    image = np.frombuffer(messages["/image"][2][1].data, dtype=np.uint8)
    assert cv2.imdecode(image, cv2.IMREAD_GRAYSCALE).shape == (120, 160)
    cloud = messages["/map"][4][1]
    points = np.frombuffer(cloud.data, dtype=np.uint8).reshape(-1, cloud.point_stride)
    xyz = np.ascontiguousarray(points[:, :12]).view("<f4")
    expected = exact_run.landmarks(4, exact_run.LENSES["radtan4"])
    np.testing.assert_allclose(xyz, expected.xyz, atol=1e-5)
    tracked = messages["/features"][5][1].points[1]
    marks = np.array([(point.x, point.y) for point in tracked.points])
    seen = exact_run.sightings(5, exact_run.LENSES["radtan4"]).xy
    np.testing.assert_allclose(marks, seen, atol=1e-3)
    assert messages["/calibration"][0][1].distortion_model == "plumb_bob"


@pytest.mark.parametrize("kind", [PlyRecorder, McapRecorder])
def test_a_full_disk_ends_the_output_but_not_the_run(
    kind: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full here")
    link = tmp_path / "full"
    link.symlink_to("/dev/full")
    recorder, other = kind(link), ColmapRecorder(tmp_path / "model")
    both = SeveralRecorders([recorder, other])
    name = kind.__name__.removesuffix("Recorder")
    with caplog.at_level(logging.WARNING):
        record(both)
    assert [r.getMessage() for r in caplog.records if "stopped" in r.getMessage()] == [
        f"the {name} output stopped and is incomplete: No space left on device"
    ]
    assert (tmp_path / "model" / "sparse" / "0" / "images.txt").is_file()


@pytest.mark.parametrize("kind", [PlyRecorder, McapRecorder, ColmapRecorder])
def test_an_output_that_cannot_be_written_is_an_error_before_the_run(
    kind: Any, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="choose another"):
        kind(tmp_path / "file" / "below").begin("a", RIG, None)


@pytest.fixture(scope="module")
def exported(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    exports = Exports(folder / "a.mcap", folder / "model", folder / "map.ply")
    run(
        synthetic_stereo,
        folder / "run",
        config=load_config("fast"),
        end=RUN_FRAMES,
        exports=exports,
    )
    return folder


def test_exports_contain_the_whole_run(exported: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    summary = json.loads((exported / "run" / "summary.json").read_text(encoding="utf-8"))
    model = pycolmap.Reconstruction(str(exported / "model" / "sparse" / "0"))
    assert model.num_images() == summary["keyframes"]
    assert model.num_points3D() > 300
    assert colmap_errors(model).mean() < 1.0
    path = read_tum(exported / "run" / "trajectory.tum")
    for image in model.images.values():
        (row,) = np.flatnonzero(path.stamps_ns == int(image.name.removesuffix(".png")))
        np.testing.assert_allclose(image.projection_center(), path.positions[row], atol=1e-6)
        assert (exported / "model" / "images" / image.name).is_file()
    assert len(read_ply(exported / "map.ply")) == model.num_points3D()
    messages = read_mcap(exported / "a.mcap")
    assert len(messages["/image"]) == RUN_FRAMES
    causal = read_tum(exported / "run" / "causal.tum")
    poses = [each.pose.position for _, each in messages["/pose"]]
    np.testing.assert_allclose([(p.x, p.y, p.z) for p in poses], causal.positions, atol=1e-6)


def test_exports_do_not_change_the_results(
    exported: Path, synthetic_stereo: Path, tmp_path: Path
) -> None:
    run(synthetic_stereo, tmp_path, config=load_config("fast"), end=RUN_FRAMES)
    for name in ("trajectory.tum", "causal.tum", "covariance.csv"):
        assert (tmp_path / name).read_bytes() == (exported / "run" / name).read_bytes()


def test_vo_run_continues_if_an_export_fails(
    synthetic_stereo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = DurableFile.write

    def limited(file: DurableFile, data: bytes) -> int:
        if file.tell() + len(data) > 100_000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(file, data)

    monkeypatch.setattr(DurableFile, "write", limited)
    monkeypatch.setattr("vo.outputs.recorders.mcap_recorder._FLUSH_S", 0.0)
    arguments = ["run", str(synthetic_stereo), "-o", str(tmp_path / "out"), "--end", "5"]
    arguments += ["--config", "fast", "--mcap", str(tmp_path / "a.mcap")]
    arguments += ["--colmap", str(tmp_path / "model"), "--ply", str(tmp_path / "map.ply")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    warning = "the Mcap output stopped and is incomplete: No space left on device"
    assert warning in " ".join(result.output.split())
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 5
    assert (tmp_path / "model" / "sparse" / "0" / "points3D.txt").is_file()
    assert len(read_ply(tmp_path / "map.ply")) > 100
    assert last_record_is_whole(tmp_path / "a.mcap")


def last_record_is_whole(path: Path) -> bool:
    """Whether an MCAP file without footer ends where a record ends."""
    data = path.read_bytes()
    position = 8  # after the magic
    while position < len(data):
        position += 9 + int.from_bytes(data[position + 1 : position + 9], "little")
    return position == len(data) > 1000
