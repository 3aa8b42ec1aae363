"""A converted recording is the same recording."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from vo.cli.app import app
from vo.cli.conversion_size import scaled_camera
from vo.config import load_config
from vo.geometry.cameras import project
from vo.inspection.material import look_into, right_stamps
from vo.run import run
from vo.sources.registry import open_source
from vo.types import Camera, Floats, Ints, Trajectory

FRAMES = 8
KINDS = [
    ("a.mcap", "mcap", "raw"),
    ("b.mcap", "mcap-ros2", "png"),
    ("c", "euroc", "png"),
    ("d", "kitti", "png"),
    ("e", "folder", "png"),
]


def vo_convert(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["convert", *map(str, arguments)])


def converted(source: Path, output: Path, *flags: object) -> Path:
    result = vo_convert(source, output, *flags)
    assert result.exit_code == 0, result.output
    return output


def path_of(recording: Path, output: Path) -> bytes:
    run(recording, output, config=load_config("fast"), end=FRAMES)
    return (output / "trajectory.tum").read_bytes()


def positions_at(truth: Trajectory, stamps_ns: Ints) -> Floats:
    """Between poses by a straight line."""
    columns = [np.interp(stamps_ns, truth.stamps_ns, axis) for axis in truth.positions.T]
    return np.stack(columns, axis=1)


@pytest.fixture(scope="module")
def true_path(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return path_of(synthetic_stereo, tmp_path_factory.mktemp("run"))


@pytest.mark.parametrize(("name", "format", "codec"), KINDS)
def test_without_loss_all_stays_as_it_was(
    synthetic_stereo: Path,
    tmp_path: Path,
    true_path: bytes,
    name: str,
    format: str,
    codec: str,
) -> None:
    flags = ("--format", format, "--codec", codec, "--end", FRAMES)
    output = converted(synthetic_stereo, tmp_path / name, *flags)
    before, after = open_source(synthetic_stereo), open_source(output)
    assert after.stamps_ns.tolist() == before.stamps_ns[:FRAMES].tolist()
    assert np.array_equal(after.rig.cam0.matrix, before.rig.cam0.matrix)
    assert after.rig.cam1_from_cam0 is not None and before.rig.cam1_from_cam0 is not None
    assert after.rig.cam1_from_cam0 == pytest.approx(before.rig.cam1_from_cam0, abs=1e-12)
    for a, b in zip(before.frames(0, FRAMES), after.frames(), strict=True):
        assert np.array_equal(a.image0, b.image0)
        assert a.image1 is not None and b.image1 is not None
        assert np.array_equal(a.image1, b.image1)
    assert after.ground_truth is not None and before.ground_truth is not None
    positions = positions_at(before.ground_truth, after.stamps_ns)
    assert np.ptp(positions, axis=0).max() > 0.1
    found = positions_at(after.ground_truth, after.stamps_ns)
    if format == "kitti":  # its world is the first camera
        positions, found = (np.linalg.norm(xyz - xyz[0], axis=1) for xyz in (positions, found))
    assert found == pytest.approx(positions, abs=1e-3)
    assert path_of(output, tmp_path / "run") == true_path


def test_right_stamps_missing_images_and_slices_survive(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    walk = Path(shutil.copytree(synthetic_stereo, tmp_path / "walk"))
    table = walk / "mav0" / "cam1" / "data.csv"
    heading, *lines = table.read_text().splitlines()
    shifted = [f"{int(line.split(',')[0]) + 1234},{line.split(',')[1]}" for line in lines]
    table.write_text("\n".join([heading, *shifted[:5], *shifted[6:]]) + "\n")
    damaged = sorted((walk / "mav0" / "cam0" / "data").iterdir())[7]
    damaged.write_bytes(damaged.read_bytes()[:300])
    output = converted(walk, tmp_path / "a.mcap", "--start", 3, "--end", 12, "--stride", 2)
    before, after = look_into(walk), look_into(output)
    left_ns = [shot.stamp_ns for shot in after.cameras[0].shots]
    all_ns = [shot.stamp_ns for shot in before.cameras[0].shots]
    assert left_ns == [all_ns[i] for i in (3, 5, 9, 11)]
    right_ns = right_stamps(after.cameras[0].shots, after.cameras[1].shots)
    assert right_ns.tolist() == [all_ns[3] + 1234, -1, all_ns[9] + 1234, all_ns[11] + 1234]


def test_a_scaled_camera_sees_the_same_corners() -> None:
    camera = Camera(640, 400, 320.0, 321.0, 325.7, 203.5, "radtan", (0.1, -0.05, 0.001, 0.002))
    small = scaled_camera(camera, 320, 100)
    points = np.random.default_rng(3).uniform((-1, -0.6, 1), (1, 0.6, 2), (50, 3))
    # The outer corner of the image is at -0.5: pixels are counted from their centres.
    expected = (project(camera, points) + 0.5) * (0.5, 0.25) - 0.5
    assert project(small, points) == pytest.approx(expected, abs=1e-9)


def test_resizing_scales_images_and_calibration_alike(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    output = converted(synthetic_stereo, tmp_path / "half", "--resize", 0.5, "--end", 2)
    before, after = open_source(synthetic_stereo), open_source(output)
    assert after.rig.cam0 == scaled_camera(
        before.rig.cam0, before.rig.cam0.width // 2, before.rig.cam0.height // 2
    )
    image, small = next(before.frames()).image0, next(after.frames()).image0
    blocks = image[: 2 * small.shape[0], : 2 * small.shape[1]].astype(float)
    means = blocks.reshape(small.shape[0], 2, small.shape[1], 2).mean(axis=(1, 3))
    assert np.abs(means - small).max() <= 1.0


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--format", "tum"), "euroc"),
        (("--codec", "raw"), "--codec png or jpeg"),
        (("--resize", "big"), "--resize big"),
        (("--format", "mcap"), "ends in .mcap"),
        (("--format", "bag"), "cannot be written"),
        (("--start", "500"), "only 30 frames"),
    ],
)
def test_what_cannot_be_is_one_line(
    synthetic_stereo: Path, tmp_path: Path, flags: tuple[str, ...], said: str
) -> None:
    result = vo_convert(synthetic_stereo, tmp_path / "out", *flags)
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ") and said in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_leaves_nothing(synthetic_stereo: Path, tmp_path: Path) -> None:
    program = [sys.executable, "-c", "from vo.cli.app import app; app()"]
    arguments = ["convert", str(synthetic_stereo), str(tmp_path / "a.mcap"), "--resize", "6"]
    process = subprocess.Popen([*program, *arguments], stderr=subprocess.DEVNULL)
    while not list(tmp_path.iterdir()) and process.poll() is None:
        time.sleep(0.005)
    os.kill(process.pid, signal.SIGINT)
    assert process.wait(timeout=60) == 130
    assert list(tmp_path.iterdir()) == []
