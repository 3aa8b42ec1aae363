"""Public data sets: their layouts, what is known of them, and the table of papers."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.base.geometry.transforms import inverse, quat_xyzw_from_rotation
from vo.cli.batch import DatasetChoice
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source
from vo.runs.batch.batch import LocalEngine, run_batch
from vo.runs.batch.datasets import DATASETS, sequences_of, table_of
from vo.runs.batch.execution import Limits
from vo.runs.batch.job import Job, JobResult, JobStatus
from vo.runs.batch.planning import plan

OPTIONS = Job("", "", "fast")


def test_every_data_set_is_a_choice() -> None:
    assert [choice.value for choice in DatasetChoice] == list(DATASETS)


def test_euroc_is_run_and_its_table_written(walks: Path, tmp_path: Path) -> None:
    shutil.copytree(walks / "walk0", tmp_path / "EuRoC" / "machine_hall" / "MH_01_easy")
    shutil.copytree(walks / "walk1", tmp_path / "EuRoC" / "vicon_room1" / "V1_01_easy")
    (tmp_path / "EuRoC" / "calibration_datasets").mkdir()
    planned = plan([str(tmp_path / "EuRoC")], OPTIONS, dataset="euroc")
    assert [job.name for job in planned.jobs] == ["MH_01_easy", "V1_01_easy"]
    result = run_batch(planned, tmp_path / "out", LocalEngine(1, Limits()))
    assert [each.status for each in result.results] == [JobStatus.DONE] * 2
    lines = (tmp_path / "out" / "table.md").read_text().splitlines()
    assert lines[0] == "| sequence | frames with a pose | ATE, m |"
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    assert [row[0] for row in cells] == ["MH_01_easy", "V1_01_easy", "mean"]
    first, second, mean = (float(row[2]) for row in cells)
    assert max(first, second) < 0.01
    assert mean == pytest.approx((first + second) / 2, abs=1e-3)


def test_kitti_as_distributed(tmp_path: Path) -> None:
    for name in ("00", "21"):
        (tmp_path / "dataset" / "sequences" / name / "image_0").mkdir(parents=True)
        (tmp_path / "dataset" / "sequences" / name / "times.txt").write_text("0\n")
    jobs = sequences_of("kitti", tmp_path, replace(OPTIONS, mode="mono", tags={"by": "me"}))
    assert [(job.name, job.mode) for job in jobs] == [("00", "mono"), ("21", "mono")]
    assert jobs[0].tags == {"by": "me", "dataset": "kitti"}


@pytest.mark.parametrize(
    ("name", "fx", "coefficients"),
    [
        ("rgbd_dataset_freiburg1_xyz", 517.306408, 5),
        ("rgbd_dataset_freiburg2_desk", 520.90862, 5),
        ("rgbd_dataset_freiburg3_long_office_household", 535.4, 0),
    ],
)
def test_tum_has_the_published_cameras(
    tmp_path: Path, name: str, fx: float, coefficients: int
) -> None:
    (tmp_path / name).mkdir()
    for file in ("rgb.txt", "groundtruth.txt"):
        (tmp_path / name / file).write_text("")
    (job,) = sequences_of("tum", tmp_path, OPTIONS)
    assert job.calibration is not None
    camera = read_calibration(job.calibration).rig.cam0
    assert (camera.fx, len(camera.distortion)) == (fx, coefficients)
    (own,) = sequences_of("tum", tmp_path, replace(OPTIONS, calibration="mine.yaml"))
    assert own.calibration == "mine.yaml"


def test_hilti_finds_calibration_and_truth_by_the_number(tmp_path: Path) -> None:
    for name in (
        *("exp04_construction_upper_level.bag", "exp05_construction_upper_level_2.bag"),
        *("alphasense-camchain-imucam.yaml", "exp_05_construction_upper_level_2_imu.txt"),
    ):
        (tmp_path / name).write_text("")
    without, with_truth = sequences_of("hilti", tmp_path, OPTIONS)
    assert without.truth is None
    assert with_truth.truth == str(tmp_path / "exp_05_construction_upper_level_2_imu.txt")
    assert with_truth.is_truth_of_body
    assert with_truth.calibration == str(tmp_path / "alphasense-camchain-imucam.yaml")
    assert with_truth.topics[1] == "right=/alphasense/cam1/image_raw"


def test_truth_of_the_body_is_moved_to_the_camera(walks: Path, tmp_path: Path) -> None:
    """The same errors as with the truth of the camera, for a body turned against it."""
    source = open_source(walks / "walk0")
    cam0 = read_tum(walks / "walk0" / "groundtruth.tum")
    sensor = read_calibration(walks / "walk0" / "mav0" / "cam0" / "sensor.yaml")
    assert sensor.body_from_cam0 is not None
    poses = cam0.world_from_cam @ inverse(sensor.body_from_cam0)
    rows = [
        [
            f"{stamp / 1e9:.9f}",
            *map(str, pose[:3, 3]),
            *map(str, quat_xyzw_from_rotation(pose[:3, :3])),
        ]
        for stamp, pose in zip(cam0.stamps_ns, poses, strict=True)
    ]
    (tmp_path / "imu.txt").write_text("".join(" ".join(row) + "\n" for row in rows))
    of_camera = Job("camera", str(walks / "walk0"), "fast")
    of_body = replace(
        of_camera,
        name="body",
        truth=str(tmp_path / "imu.txt"),
        is_truth_of_body=True,
        calibration=str(walks / "walk0" / "mav0" / "cam0" / "sensor.yaml"),
        mode="mono",
    )
    from vo.runs.batch.planning import Plan

    plans = Plan((replace(of_camera, mode="mono"), of_body))
    first, second = run_batch(plans, tmp_path / "out", LocalEngine(1, Limits())).results
    assert first.ate_m is not None
    assert second.ate_m == pytest.approx(first.ate_m, rel=1e-3)
    assert len(source) == first.frames
    assert not np.allclose(sensor.body_from_cam0, np.eye(4))


@pytest.mark.parametrize("key", list(DATASETS))
def test_a_folder_without_the_data_set_is_one_error(tmp_path: Path, key: str) -> None:
    (tmp_path / "notes").mkdir()
    with pytest.raises(SourceError, match=f"no sequence of {DATASETS[key].title}; expected is"):
        sequences_of(key, tmp_path, OPTIONS)
    with pytest.raises(SourceError, match="no sequence of"):
        sequences_of(key, tmp_path / "missing", OPTIONS)


def test_the_table_tells_what_papers_leave_out() -> None:
    done = JobResult(
        "00", "00", JobStatus.DONE, tracked_ratio=1.0, segments=1, trusted=True,
        drift_percent=0.61, drift_deg_per_100m=0.2, ate_m=1.2,
    )  # fmt: skip
    results = [
        done,
        replace(done, name="01", tracked_ratio=0.5, segments=3, trusted=False, ate_m=2.0),
        JobResult("02", "02", JobStatus.CRASHED, "ended by SIGKILL"),
    ]
    assert table_of("kitti", results).splitlines() == [
        "| sequence | frames with a pose | t_rel, % | r_rel, °/100 m | ATE, m |",
        "| --- | ---: | ---: | ---: | ---: |",
        "| 00 | 100.0 % | 0.610 | 0.200 | 1.200 |",
        "| 01 | 50.0 % in 3, not to be trusted | 0.610 | 0.200 | 2.000 |",
        "| 02 | crashed | – | – | – |",
        "| mean | 75.0 % | 0.610 | 0.200 | 1.600 |",
    ]
