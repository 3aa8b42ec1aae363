"""All outputs of a run in which an old keyframe gets a new pose, as after a loop closure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rerun.chunk import RrdReader

from vo.base.config import load_config
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Estimate, Floats, Frame
from vo.engine.odometry import Odometry
from vo.outputs.recorders import entities
from vo.outputs.recorders.exports import Exports
from vo.recordings.formats.trajectory import read_tum
from vo.runs.run_recording import run

MOVE = make_transform(so3_exp(np.array([0.0, 0.1, 0.0])), np.array([2.0, 0.0, 1.0]))
# A keyframe in almost every frame, and a local map of three, so that the first ones soon leave it.
SETTINGS = ["keyframes.max_gap_s=0.01", "smoothing.window=2", "smoothing.fixed=1"]
FRAMES, REPOSED_AT = 16, 12


class ReposingOdometry(Odometry):
    """Moves the second keyframe in the world once it has left the local map."""

    def track_all(self, frames: Iterable[Frame]) -> Iterator[Estimate]:
        for estimate in super().track_all(frames):
            yield estimate
            if estimate.frame_index == REPOSED_AT:
                store = self.trajectory
                keyframe = int(np.unique(store.frames["keyframe"])[1])
                (old,) = store.keyframes_by_id([keyframe])
                store.store(keyframe, replace(old, world_from_cam0=MOVE @ old.world_from_cam0))


@pytest.fixture(scope="module")
def runs(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the same run twice, `plain` and `reposed`."""
    folder = tmp_path_factory.mktemp("reposed")
    config = load_config("fast", SETTINGS)
    run(synthetic_stereo, folder / "plain", config=config, end=FRAMES)
    exports = Exports(folder / "a.mcap", folder / "model", folder / "map.ply")
    rrd = folder / "run.rrd"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vo.engine.rig.creation.Odometry", ReposingOdometry)
        run(
            synthetic_stereo,
            folder / "reposed",
            config=config,
            end=FRAMES,
            rrd=rrd,
            rrd_images="none",
            exports=exports,
        )
    return folder


def expected_poses(runs: Path) -> Floats:
    """Smoothed poses (N, 4, 4), those relative to the re-posed keyframe moved with it."""
    plain = read_tum(runs / "plain" / "trajectory.tum").world_from_cam
    rows = np.loadtxt(runs / "plain" / "poses.csv", delimiter=",", skiprows=1)
    first, second = np.flatnonzero(rows[:, 3] == 1)[1:3]  # keyframes
    moved = plain.copy()
    moved[first:second] = MOVE @ plain[first:second]
    return moved


def test_files_have_the_new_pose_of_the_keyframe_and_of_its_frames(runs: Path) -> None:
    written = read_tum(runs / "reposed" / "trajectory.tum")
    expected = expected_poses(runs)
    np.testing.assert_allclose(written.world_from_cam, expected, atol=1e-6)
    rows = np.loadtxt(runs / "reposed" / "poses.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows[:, 5:8], expected[:, :3, 3], atol=1e-6)
    for name in ("causal.tum", "covariance.csv"):
        assert (runs / "reposed" / name).read_bytes() == (runs / "plain" / name).read_bytes()


def test_the_recording_has_the_new_pose(runs: Path) -> None:
    expected = expected_poses(runs)
    stamps, rows, chunks = [], [], set()
    for chunk in RrdReader(runs / "run.rrd").stream().to_chunks():
        batch, entity = chunk.to_record_batch(), chunk.entity_path.lstrip("/")
        if entity == entities.SMOOTHED_POSES and "Scalars:scalars" in batch.schema.names:
            stamps += batch[entities.SENSOR_TIMELINE].cast("int64").to_pylist()
            rows += batch["Scalars:scalars"].to_pylist()
        if entity.startswith(f"{entities.SETTLED_LANDMARKS}_chunks/"):
            chunks.add(entity)
    positions = np.array(rows)[np.argsort(stamps), :3]
    np.testing.assert_allclose(positions, expected[:, :3, 3], atol=1e-6)
    assert chunks


def test_exports_have_the_new_pose(runs: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    written = read_tum(runs / "reposed" / "trajectory.tum")
    model = pycolmap.Reconstruction(str(runs / "model" / "sparse" / "0"))
    assert model.num_images() > 8
    for image in model.images.values():
        (row,) = np.flatnonzero(written.stamps_ns == int(image.name.removesuffix(".png")))
        np.testing.assert_allclose(image.projection_center(), written.positions[row], atol=1e-6)
    with (runs / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        paths = [decoded for *_, decoded in reader.iter_decoded_messages(topics=["/path"])]
    found = [(p.position.x, p.position.y, p.position.z) for p in paths[-1].poses]
    np.testing.assert_allclose(found, written.positions, atol=1e-6)
    # Written again in the frame after the re-posing, with the frames of that keyframe moved.
    (after,) = [path.poses for path in paths if len(path.poses) == REPOSED_AT + 2]
    causal = read_tum(runs / "plain" / "causal.tum").positions[: REPOSED_AT + 2]
    positions = np.array([(p.position.x, p.position.y, p.position.z) for p in after])
    assert 1 <= np.count_nonzero(np.linalg.norm(positions - causal, axis=1) > 1.0) <= 3
