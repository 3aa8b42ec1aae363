"""Recordings of real runs: poses and size."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from vo.base.config import load_config
from vo.base.geometry.transforms import rotation_from_quat_xyzw
from vo.base.types import Trajectory
from vo.outputs.recorders import entities
from vo.recordings.formats.trajectory import read_tum
from vo.runs.run_recording import run


def poses_in(path: Path, entity: str) -> Trajectory:
    """Poses of an entity in a recording."""
    stamps, rows = [], []
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path == f"/{entity}" and "Scalars:scalars" in batch.schema.names:
            stamps += batch[entities.SENSOR_TIMELINE].cast("int64").to_pylist()
            rows += batch["Scalars:scalars"].to_pylist()
    order = np.argsort(stamps)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    for pose, row in zip(poses, np.array(rows)[order], strict=True):
        pose[:3, 3] = row[:3]
        pose[:3, :3] = rotation_from_quat_xyzw(row[3:])
    return Trajectory(np.array(stamps)[order], poses)


@pytest.mark.parametrize("mode", ["stereo", "mono"])
def test_poses_equal_those_of_the_files(synthetic_stereo, tmp_path, mode):
    rrd = tmp_path / "run.rrd"
    run(synthetic_stereo, tmp_path, config=load_config("fast"), end=14, mode=mode, rrd=rrd)
    for entity, name in (
        (entities.SMOOTHED_POSES, "trajectory.tum"),
        (entities.CAUSAL_POSES, "causal.tum"),
    ):
        recorded, written = poses_in(rrd, entity), read_tum(tmp_path / name)
        np.testing.assert_array_equal(recorded.stamps_ns, written.stamps_ns)
        np.testing.assert_allclose(recorded.world_from_cam, written.world_from_cam, atol=1e-6)
    verify = [Path(sys.executable).parent / "rerun", "rrd", "verify", rrd]
    assert subprocess.run(verify, capture_output=True, timeout=60).returncode == 0


def test_a_frame_of_kitti_takes_less_than_60_kb(shared_data, tmp_path):
    rrd, frames = tmp_path / "run.rrd", 51
    source = shared_data / "kitti06_stereo_000-050"
    run(source, tmp_path, config=load_config("default"), rrd=rrd)
    assert rrd.stat().st_size / frames < 60_000
