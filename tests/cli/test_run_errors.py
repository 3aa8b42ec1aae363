"""Messages of `vo run` about bad input, wrong settings and wrong usage."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from run_calls import CALIBRATION, WIDTH, summary_in, vo_run, write_noise
from typer.testing import CliRunner, Result

from vo.base.types import Trajectory
from vo.cli.app import app
from vo.recordings.formats.trajectory import read_tum, write_tum


def assert_one_line(result: Result, *words: str) -> None:
    assert result.exit_code == 1, result.output
    assert result.stdout == ""
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    others = [line for line in result.stderr.splitlines() if not line.startswith("error: ")]
    assert len(errors) == 1, result.stderr
    assert all("no calibration: focal length" in line for line in others)
    for word in words:
        assert word in errors[0]


def test_missing_folder(tmp_path: Path, out: Path) -> None:
    assert_one_line(vo_run(tmp_path / "none", out), "none does not exist")
    assert not out.exists()


def test_folder_without_images(tmp_path: Path, out: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert_one_line(vo_run(tmp_path / "empty", out), "has no images")


def test_unreadable_image_in_the_middle_is_skipped(images: Path, out: Path) -> None:
    data = (images / "2.png").read_bytes()
    (images / "2.png").write_bytes(data[: len(data) // 2])
    result = vo_run(images, out)
    assert result.exit_code == 3, result.output
    warnings = [w for w in result.stderr.splitlines() if w.startswith("warning: ")]
    assert len(warnings) == 1
    assert "frame 2 skipped" in warnings[0]
    assert "cut off" in warnings[0]
    summary = summary_in(out)
    assert [(s["index"], s["stamp_ns"]) for s in summary["skipped"]] == [(2, 200_000_000)]
    assert summary["frames"] == 5


def test_image_of_another_size_in_the_middle_is_skipped(images: Path, out: Path) -> None:
    write_noise(images / "3.png", 3, width=WIDTH // 2)
    result = vo_run(images, out)
    assert result.exit_code == 3, result.output
    assert "frame 3 skipped" in result.stderr
    assert "48x64" in result.stderr
    assert [s["index"] for s in summary_in(out)["skipped"]] == [3]


def test_the_next_command_includes_the_calibration(images: Path, out: Path) -> None:
    chosen = images.parent / "my camera.yaml"
    (images / "calibration.yaml").rename(chosen)
    result = vo_run(images, out, "--calibration", chosen)
    assert result.exit_code == 3, result.output
    (again,) = [line for line in result.stdout.splitlines() if line.startswith("next: vo run")]
    assert f"--calibration '{chosen}'" in again


def test_missing_calibration(images: Path, out: Path) -> None:
    (images / "calibration.yaml").unlink()
    assert_one_line(vo_run(images, out), "calibration")


def test_missing_calibration_file(images: Path, out: Path) -> None:
    result = vo_run(images, out, "--calibration", images / "none.yaml")
    assert_one_line(result, "none.yaml")


@pytest.mark.parametrize("fx", [".nan", "0.0", "-80.0", ".inf"])
def test_invalid_calibration(images: Path, out: Path, fx: str) -> None:
    (images / "calibration.yaml").write_text(CALIBRATION.format(fx=fx), encoding="utf-8")
    assert_one_line(vo_run(images, out), "calibration.yaml", fx.strip(".").removesuffix(".0"))


def test_more_images_than_stamps(images: Path, out: Path) -> None:
    (images / "times.txt").write_text("0.0\n0.1\n0.2\n", encoding="utf-8")
    assert_one_line(vo_run(images, out), "5", "3")


def test_stamps_that_do_not_increase(images: Path, out: Path) -> None:
    (images / "times.txt").write_text("0.0\n0.1\n0.3\n0.2\n0.4\n", encoding="utf-8")
    assert_one_line(vo_run(images, out), "times.txt")


def test_unknown_setting_suggests_the_most_similar(images: Path, out: Path) -> None:
    result = vo_run(images, out, "--set", "features.cuont=100")
    assert_one_line(result, "features.cuont", "did you mean 'features.count'?")
    assert not out.exists()


def test_unknown_preset(images: Path, out: Path) -> None:
    assert_one_line(vo_run(images, out, "--config", "fats"), "did you mean 'fast'?")


def test_unknown_format(images: Path, out: Path) -> None:
    assert_one_line(vo_run(images, out, "--format", "kiti"), "kiti", "kitti")


def test_mode_stereo_without_a_right_camera(
    synthetic_stereo: Path, tmp_path: Path, out: Path
) -> None:
    source = tmp_path / "left_only"
    shutil.copytree(synthetic_stereo / "mav0" / "cam0", source / "mav0" / "cam0")
    assert_one_line(vo_run(source, out, "--mode", "stereo"), "right camera", "--mode mono")


@pytest.mark.parametrize("inside", ["out", "deeper/out"])
def test_output_that_cannot_be_written(images: Path, tmp_path: Path, inside: str) -> None:
    (tmp_path / "file").touch()
    assert_one_line(vo_run(images, tmp_path / "file" / inside), "cannot write to folder")


def test_output_that_is_a_file(images: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert_one_line(vo_run(images, tmp_path / "file"), "cannot write to folder")


def test_recording_that_cannot_be_written(images: Path, tmp_path: Path, out: Path) -> None:
    (tmp_path / "file").touch()
    result = vo_run(images, out, "--rrd", tmp_path / "file" / "run.rrd")
    assert_one_line(result, "cannot write the recording")


def test_start_beyond_the_end(images: Path, out: Path) -> None:
    assert_one_line(vo_run(images, out, "--start", 5), "only 5 frames")


def test_ground_truth_without_overlap(synthetic_stereo: Path, out: Path) -> None:
    vo_run(synthetic_stereo, out, "--end", 4, "--config", "fast")
    true = read_tum(synthetic_stereo / "groundtruth.tum")
    late = out.with_name("late.tum")
    write_tum(late, Trajectory(true.stamps_ns + 10**12, true.world_from_cam))
    assert_one_line(CliRunner().invoke(app, ["eval", str(out), str(late)]))


@pytest.mark.parametrize(
    "wrong",
    [("--stride", "0"), ("--start", "-1"), ("--end", "-1"), ("--mode", "both"), ("--bogus",)],
)
def test_wrong_usage_exits_2(images: Path, out: Path, wrong: tuple[str, ...]) -> None:
    result = vo_run(images, out, *wrong)
    assert result.exit_code == 2
    assert wrong[0] in result.stderr
    assert not out.exists()
