from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from vo.base.geometry.transforms import se3_exp
from vo.base.types import Trajectory
from vo.cli.app import app
from vo.recordings.formats.trajectory import write_tum


@pytest.fixture
def walk() -> Trajectory:
    moves = [se3_exp(np.array([0.02, 0.1, 0.01, 0.0, 0.0, 0.8])) for _ in range(40)]
    poses = [np.eye(4)]
    for move in moves:
        poses.append(poses[-1] @ move)
    return Trajectory(np.arange(41, dtype=np.int64) * 100_000_000, np.array(poses))


@pytest.fixture
def truth(tmp_path: Path, walk: Trajectory) -> Path:
    write_tum(tmp_path / "groundtruth.tum", walk)
    return tmp_path / "groundtruth.tum"


@pytest.fixture
def run_folder(tmp_path: Path, walk: Trajectory) -> Path:
    """A mono run with half the true scale."""
    folder = tmp_path / "out"
    folder.mkdir()
    poses = walk.world_from_cam.copy()
    poses[:, :3, 3] /= 2.0
    write_tum(folder / "trajectory.tum", Trajectory(walk.stamps_ns, poses))
    (folder / "summary.json").write_text('{"mode": "mono"}', encoding="utf-8")
    return folder


def vo_eval(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["eval", *map(str, arguments)])


def test_table_for_people(run_folder: Path, truth: Path) -> None:
    result = vo_eval(run_folder, truth)
    assert result.exit_code == 0, result.output
    assert "sim3 (auto: mono estimate, scale unknown)" in result.output
    assert "multiplied by 2.000000" in result.output
    assert "ATE, translation" in result.output
    assert "drift over sub-paths" in result.output
    assert "\x1b" not in result.output


@pytest.mark.parametrize("columns", [30, 60, 200])
def test_numbers_and_names_are_whole_in_any_terminal(
    run_folder: Path, truth: Path, columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    odd = run_folder.rename(run_folder.with_name("out[bold]"))
    lines = vo_eval(odd, truth).output.splitlines()
    assert f"estimate   {odd}/trajectory.tum (41 poses)" in lines
    row = next(line for line in lines if line.startswith("RPE per frame, translation"))
    assert [len(number) for number in row.split()[-4:]] == [len("0.000000")] * 4
    assert "…" not in "".join(lines)


def test_scale_error_is_printed_when_scale_is_not_aligned(run_folder: Path, truth: Path) -> None:
    result = vo_eval(run_folder, truth, "--align", "se3")
    assert "se3 (as requested)" in result.output
    assert "error -50.000 %" in result.output


def test_json_for_machines(run_folder: Path, truth: Path) -> None:
    result = vo_eval(run_folder, truth, "--json", "--delta", 3, "--delta-m", 4, "--interpolate")
    assert result.exit_code == 0, result.output
    numbers = json.loads(result.stdout)
    assert numbers["mode"] == "mono"
    assert numbers["matched"] == 41
    assert numbers["alignment"]["kind"] == "sim3"
    assert numbers["ate"]["translation_m"]["rmse"] < 1e-6
    assert numbers["rpe_frames"]["delta_frames"] == 3
    assert numbers["rpe_metres"]["delta_m"] == 4.0
    assert numbers["association"]["method"] == "interpolated"
    assert numbers["picture"] is None


def test_delta_of_any_size_is_accepted(run_folder: Path, truth: Path) -> None:
    result = vo_eval(run_folder, truth, "--delta", 10**30, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["rpe_frames"] is None


def test_plot(run_folder: Path, truth: Path, tmp_path: Path) -> None:
    result = vo_eval(run_folder, truth, "--picture", tmp_path / "eval.png")
    assert result.exit_code == 0, result.output
    assert f"picture: {tmp_path / 'eval.png'}" in result.output
    assert (tmp_path / "eval.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "eval.png").stat().st_size > 20_000


def test_a_standing_camera_compared_without_alignment(tmp_path: Path) -> None:
    still = Trajectory(np.arange(3) * 10**8, np.tile(np.eye(4), (3, 1, 1)))
    write_tum(tmp_path / "still.tum", still)
    result = vo_eval(tmp_path / "still.tum", tmp_path / "still.tum", "--align", "none")
    assert result.exit_code == 0, result.output
    assert "RPE over 1 m" in result.output


def assert_one_line(result: Result, *words: str) -> None:
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr


def test_missing_estimate(truth: Path, tmp_path: Path) -> None:
    assert_one_line(vo_eval(tmp_path / "none.tum", truth), "none.tum does not exist")


def test_folder_without_trajectory(truth: Path, tmp_path: Path) -> None:
    assert_one_line(vo_eval(tmp_path, truth), "no trajectory.tum")


def test_damaged_reference(run_folder: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.txt").write_text("0 1 2 3 0 0 0 1\n1 1 2 x 0 0 0 1\n", encoding="utf-8")
    assert_one_line(vo_eval(run_folder, tmp_path / "bad.txt"), "bad.txt:2", "'x'")


def test_one_warning_about_gaps_of_the_truth(run_folder: Path, truth: Path) -> None:
    lines = truth.read_text(encoding="utf-8").splitlines()
    gap = " nan" * 7
    lines[5:10] = [line.split()[0] + gap for line in lines[5:10]]
    truth.write_text("\n".join(lines), encoding="utf-8")
    result = vo_eval(run_folder, truth, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["matched"] == 36
    assert result.stderr.count("warning: ") == result.stderr.count("\n") == 1
    assert "5 of 41 lines are not poses" in result.stderr

    truth.write_text("".join(f"{i}{gap}\n" for i in range(9)), encoding="utf-8")
    assert_one_line(vo_eval(run_folder, truth), "groundtruth.tum:1", "9 of 9 lines are not poses")


def test_error_names_time_spans_without_overlap(
    run_folder: Path, walk: Trajectory, tmp_path: Path
) -> None:
    late = Trajectory(walk.stamps_ns + 60_000_000_000, walk.world_from_cam)
    write_tum(tmp_path / "late.tum", late)
    result = vo_eval(run_folder, tmp_path / "late.tum")
    assert_one_line(result, "0.000 to 4.000 s", "60.000 to 64.000 s")


def test_too_few_poses_to_align(truth: Path, tmp_path: Path, walk: Trajectory) -> None:
    write_tum(tmp_path / "two.tum", Trajectory(walk.stamps_ns[:2], walk.world_from_cam[:2]))
    assert_one_line(vo_eval(tmp_path / "two.tum", truth), "2 matched poses cannot be aligned")


def test_plot_of_unknown_kind(run_folder: Path, truth: Path, tmp_path: Path) -> None:
    result = vo_eval(run_folder, truth, "--picture", tmp_path / "eval.bmp")
    assert_one_line(result, "unsupported kind of plot")


@pytest.mark.parametrize(
    "wrong", [("--align", "best"), ("--tolerance", "-1"), ("--delta", "0"), ("--bogus",)]
)
def test_wrong_usage_exits_2(run_folder: Path, truth: Path, wrong: tuple[str, ...]) -> None:
    result = vo_eval(run_folder, truth, *wrong)
    assert result.exit_code == 2 and "Value error" not in result.stderr


def test_help_contains_an_example() -> None:
    result = vo_eval("--help")
    assert result.exit_code == 0
    assert "vo eval out/ my_sequence/" in result.output


def test_the_command_imports_nothing_heavy_before_it_runs() -> None:
    code = (
        "import sys, vo.cli.eval; "
        "print([m for m in ('numpy', 'matplotlib', 'cv2', 'gtsam') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_truth_of_the_colour_cameras_of_kitti_is_that_of_info(tmp_path: Path) -> None:
    """poses.txt is that of the grey left camera, 6 cm beside the left colour camera."""
    sequence = tmp_path / "sequence"
    (sequence / "image_2").mkdir(parents=True)
    image = np.random.default_rng(0).integers(0, 255, (40, 60), dtype=np.uint8)
    angles = np.linspace(0, 2, 20)
    poses = np.array([se3_exp(np.array([0, a, 0, 5 * a, 0, 0])) for a in angles])
    moved = poses @ se3_exp(np.array([0, 0, 0, 0.06, 0, 0]))
    for i in range(20):
        cv2.imwrite(str(sequence / "image_2" / f"{i:06d}.png"), image)
    rows = [" ".join(f"{v:.9f}" for v in pose[:3].ravel()) for pose in poses]
    (sequence / "poses.txt").write_text("\n".join(rows) + "\n")
    (sequence / "times.txt").write_text("".join(f"{0.1 * i:.1f}\n" for i in range(20)))
    p = "50 0 30 {} 0 50 20 0 0 0 1 0"
    lines = [f"P{i}: {p.format(shift)}" for i, shift in enumerate((0, -25, -3, -28))]
    (sequence / "calib.txt").write_text("\n".join(lines) + "\n")
    stamps = np.arange(20, dtype=np.int64) * 100_000_000
    write_tum(tmp_path / "estimate.tum", Trajectory(stamps, moved))
    result = vo_eval(tmp_path / "estimate.tum", sequence, "--align", "none", "--json")
    assert json.loads(result.stdout)["ate"]["translation_m"]["max"] < 1e-6


def test_two_runs_are_compared(run_folder: Path, walk: Trajectory, truth: Path) -> None:
    """A mono run beside one in metres: aligned with scale, either way round."""
    other = run_folder.with_name("stereo")
    other.mkdir()
    write_tum(other / "trajectory.tum", walk)
    segment = {"first_stamp_ns": 0, "last_stamp_ns": 3_000_000_000}
    later = {"first_stamp_ns": 3_100_000_000, "last_stamp_ns": 4_000_000_000}
    record = {"mode": "stereo", "length_unit": "m", "segments": [segment, later]}
    (other / "summary.json").write_text(json.dumps(record), encoding="utf-8")
    for first, second, scale in ((run_folder, other, 2.0), (other, run_folder, 0.5)):
        result = vo_eval(first, second, "--json")
        assert result.exit_code == 0, result.output
        found = json.loads(result.stdout)
        assert found["alignment"]["scale"] == pytest.approx(scale, rel=1e-6)
        assert found["matched"] == 31
        assert found["ate"]["translation_m"]["rmse"] < 1e-6
        notes = " ".join(found["notes"])
        assert "differences, not errors" in notes and "only the longest is evaluated" in notes
        assert ("in its map units, not metres" in notes) == (second == run_folder)
    swapped = vo_eval(truth, other)
    assert swapped.exit_code == 1
    assert "give the run first, then the ground truth" in swapped.stderr
