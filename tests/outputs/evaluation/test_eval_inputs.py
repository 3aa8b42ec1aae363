from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from vo.base.errors import CalibrationError, EvaluationError, SourceError
from vo.base.geometry.transforms import quat_xyzw_from_rotation, se3_exp
from vo.outputs.evaluation.evaluation import evaluate
from vo.outputs.evaluation.inputs import load_inputs

TUM = "".join(f"{i}.5 {i} {i * i} 0 0 0 0 1\n" for i in range(6))
KITTI = "".join(f"1 0 0 {i} 0 1 0 {i * i} 0 0 1 0\n" for i in range(6))
EUROC = "".join(f"{i}500000000,{i},{i * i},0,1,0,0,0\n" for i in range(6))
SENSOR = "T_BS:\n  cols: 4\n  data: [0,0,1,0.5, -1,0,0,0, 0,-1,0,0, 0,0,0,1]\n"


def run_folder(folder: Path, summary: object | None = None) -> Path:
    folder.mkdir()
    (folder / "trajectory.tum").write_text(TUM, encoding="utf-8")
    if summary is not None:
        (folder / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    return folder


def written(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("mode", ["mono", "stereo"])
def test_mode_is_read_from_the_summary(tmp_path: Path, mode: str) -> None:
    run = run_folder(tmp_path / "run", {"mode": mode})
    truth = written(tmp_path / "groundtruth.tum", TUM)
    assert load_inputs(run, truth).mode == mode
    assert load_inputs(run / "trajectory.tum", truth).mode == mode


@pytest.mark.parametrize("summary", [None, {}, {"mode": 7}, ["mono"]])
def test_mode_is_auto_without_a_valid_summary(tmp_path: Path, summary: object) -> None:
    run = run_folder(tmp_path / "run", summary)
    assert load_inputs(run, written(tmp_path / "groundtruth.tum", TUM)).mode == "auto"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("groundtruth.tum", TUM),
        ("groundtruth.txt", TUM),
        ("poses.txt", KITTI),
        ("mav0/state_groundtruth_estimate0/data.csv", EUROC),
        ("state_groundtruth_estimate0/data.csv", EUROC),
    ],
)
def test_ground_truth_is_found_in_a_sequence_folder(tmp_path: Path, name: str, text: str) -> None:
    path = written(tmp_path / "sequence" / name, text)
    inputs = load_inputs(run_folder(tmp_path / "run"), tmp_path / "sequence")
    assert inputs.reference_path == path
    assert evaluate(inputs.estimate, inputs.reference, "none").ate.translation.max == 0.0


def test_folders_without_trajectory_or_ground_truth(tmp_path: Path) -> None:
    truth = written(tmp_path / "truth.tum", TUM)
    with pytest.raises(SourceError, match=r"no trajectory\.tum"):
        load_inputs(tmp_path, truth)
    with pytest.raises(SourceError, match="no ground truth"):
        load_inputs(truth, tmp_path)
    with pytest.raises(SourceError, match="output of a run, not ground truth; give the run first"):
        load_inputs(truth, run_folder(tmp_path / "run"))


def test_euroc_truth_is_moved_to_the_camera(tmp_path: Path) -> None:
    written(tmp_path / "mav0/cam0/sensor.yaml", SENSOR)
    written(tmp_path / "mav0/state_groundtruth_estimate0/data.csv", EUROC)
    inputs = load_inputs(run_folder(tmp_path / "run"), tmp_path)
    np.testing.assert_array_equal(inputs.reference.positions[1], [1.5, 1.0, 0.0])
    np.testing.assert_array_equal(
        inputs.reference.world_from_cam[0, :3, :3], [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    )
    assert "moved from the body to cam0, by its pose in" in inputs.notes[0]
    assert "sensor.yaml" in inputs.notes[0]


CHAIN = """\
cam0:
  camera_model: pinhole
  distortion_model: none
  distortion_coeffs: []
  intrinsics: [60, 60, 40, 25]
  resolution: [80, 50]
  T_cam_imu: [[0,-1,0,0], [0,0,-1,0], [1,0,0,-0.5], [0,0,0,1]]
"""
"""The same pose as in `SENSOR`, inverted, as Kalibr writes it."""


@pytest.mark.parametrize(
    "name",
    [
        "mav0/camchain.yaml",
        "camchain.yaml",
        "../camchain.yaml",
        "dso/camchain.yaml",
        "imu-results-camchain.yaml",
        "mav0/calibration.yaml",
    ],
)
def test_camera_pose_of_kalibr_is_used_as_by_the_other_commands(tmp_path: Path, name: str) -> None:
    sequence = tmp_path / "all" / "one"
    written(sequence / "mav0/state_groundtruth_estimate0/data.csv", EUROC)
    file = written(sequence / name, CHAIN)
    inputs = load_inputs(run_folder(tmp_path / "run"), sequence)
    np.testing.assert_allclose(inputs.reference.positions[1], [1.5, 1.0, 0.0], atol=1e-12)
    assert str(file.resolve()) in inputs.notes[0]


def test_calibration_of_the_user_or_else_of_the_run_is_preferred(tmp_path: Path) -> None:
    truth = written(tmp_path / "mav0/state_groundtruth_estimate0/data.csv", EUROC)
    written(tmp_path / "mav0/cam0/sensor.yaml", SENSOR.replace("0.5", "7"))
    mine = written(tmp_path / "mine.yaml", CHAIN)
    run = run_folder(tmp_path / "run", {"calibration": str(mine)})
    assert load_inputs(run, tmp_path).reference.positions[1, 0] == 1.5
    other = written(tmp_path / "other.yaml", CHAIN.replace("0.5", "0.25"))
    assert load_inputs(run, truth, calibration=other).reference.positions[1, 0] == 1.25


def test_euroc_truth_without_camera_pose_is_noted(tmp_path: Path) -> None:
    written(tmp_path / "mav0/state_groundtruth_estimate0/data.csv", EUROC)
    inputs = load_inputs(run_folder(tmp_path / "run"), tmp_path)
    assert "taken as that of the camera" in inputs.notes[0]


@pytest.mark.parametrize("text", ["", "T_BS: 7", "T_BS: {data: [1, 2]}", "a: [", "T_BS: {data: x}"])
def test_damaged_sensor_yaml(tmp_path: Path, text: str) -> None:
    written(tmp_path / "mav0/cam0/sensor.yaml", text)
    written(tmp_path / "mav0/state_groundtruth_estimate0/data.csv", EUROC)
    with pytest.raises(CalibrationError, match="sensor.yaml: T_BS"):
        load_inputs(run_folder(tmp_path / "run"), tmp_path)


def test_poses_without_stamps_are_paired_row_by_row(tmp_path: Path) -> None:
    run, poses = run_folder(tmp_path / "run"), written(tmp_path / "poses.txt", KITTI)
    for estimate, reference in ((run, poses), (poses, run / "trajectory.tum")):
        inputs = load_inputs(estimate, reference)
        np.testing.assert_array_equal(inputs.estimate.stamps_ns, inputs.reference.stamps_ns)
        assert "row by row" in inputs.notes[0]
    assert "neither file has stamps" in load_inputs(poses, poses).notes[0]


def test_poses_without_stamps_of_another_number_are_refused(tmp_path: Path) -> None:
    poses = written(tmp_path / "poses.txt", KITTI + "1 0 0 7 0 1 0 7 0 0 1 0\n")
    with pytest.raises(EvaluationError, match=r"has no stamps.*6 and 7.*times\.txt"):
        load_inputs(run_folder(tmp_path / "run"), poses)


def test_only_the_longest_segment_is_evaluated(tmp_path: Path) -> None:
    spans = [(500_000_000, 1_500_000_000), (2_500_000_000, 5_500_000_000)]
    segments = [{"first_stamp_ns": a, "last_stamp_ns": b} for a, b in spans]
    run = run_folder(tmp_path / "run", {"mode": "mono", "segments": segments})
    truth = written(tmp_path / "groundtruth.tum", TUM)
    inputs = load_inputs(run, truth)
    assert inputs.estimate.stamps_ns.tolist() == [i * 10**9 + 500_000_000 for i in range(2, 6)]
    assert "2 segments" in inputs.notes[0]
    assert "4 of 6 poses" in inputs.notes[0]
    assert len(load_inputs(run, truth, all_segments=True).estimate) == 6


def test_a_segment_between_two_merged_ones_is_not_taken_for_a_part_of_them(tmp_path: Path) -> None:
    spans = [(500_000_000, 5_500_000_000), (2_500_000_000, 2_500_000_000)]
    segments = [
        {"segment": number, "first_stamp_ns": a, "last_stamp_ns": b}
        for number, (a, b) in enumerate(spans)
    ]
    run = run_folder(tmp_path / "run", {"mode": "mono", "segments": segments})
    rows = [f"{i},{i * 10**9 + 500_000_000},{int(i == 2)},0" for i in range(6)]
    written(run / "poses.csv", "\n".join(["frame,stamp_ns,segment,keyframe", *rows]) + "\n")
    inputs = load_inputs(run, written(tmp_path / "groundtruth.tum", TUM))
    assert inputs.estimate.stamps_ns.tolist() == [i * 10**9 + 500_000_000 for i in (0, 1, 3, 4, 5)]


@pytest.mark.parametrize("segments", [1, [], [{}], [{}, {}], [{"first_stamp_ns": "x"}, 3]])
def test_invalid_segments_are_ignored(tmp_path: Path, segments: object) -> None:
    run = run_folder(tmp_path / "run", {"segments": segments})
    inputs = load_inputs(run, written(tmp_path / "groundtruth.tum", TUM))
    assert len(inputs.estimate) == 6
    assert inputs.notes == ()


def test_tum_and_euroc_truth_of_the_rendered_hall_agree(tmp_path: Path, shared_data: Path) -> None:
    hall = shared_data / "rendered_hall_stereo"
    inputs = load_inputs(
        hall / "groundtruth.tum", hall / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    )
    evaluation = evaluate(inputs.estimate, inputs.reference, "none")
    assert evaluation.ate.translation.max < 1e-6
    assert evaluation.ate.rotation.max < 1e-4


def _camera_path() -> list[np.ndarray]:
    """world_from_cam0 of a camera that turns and climbs, with y down and z forward."""
    return [se3_exp(np.array([0.02 * i, 0.3 * i, 0.1, 0.2 * i, 0.5, i])) for i in range(6)]


def _tum(poses: list[np.ndarray]) -> str:
    rows = []
    for i, pose in enumerate(poses):
        quat = quat_xyzw_from_rotation(pose[:3, :3])
        rows.append(" ".join(f"{v:.12f}" for v in (i + 0.5, *pose[:3, 3], *quat)))
    return "\n".join(rows) + "\n"


def _without_stamps(text: str) -> str:
    return "".join(f"{line.split(' ', 1)[1]}\n" for line in text.splitlines())


def test_ground_truth_of_tartanair(tmp_path: Path) -> None:
    """Poses in north, east, down; the camera with x forward, y right, z down; no stamps."""
    ned_from_world = np.array([[0, 0, 1, 5], [1, 0, 0, -2], [0, 1, 0, 3], [0, 0, 0, 1.0]])
    forward_right_down = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
    poses = _camera_path()
    truth = [ned_from_world @ pose @ forward_right_down for pose in poses]
    run = run_folder(tmp_path / "run")
    written(run / "trajectory.tum", _tum(poses))
    written(tmp_path / "P000" / "pose_left.txt", _without_stamps(_tum(truth)))
    for reference in (tmp_path / "P000" / "pose_left.txt", tmp_path / "P000"):
        inputs = load_inputs(run, reference)
        assert "TartanAir's: camera axes x forward, y right, z down" in inputs.notes[0]
        assert "row by row" in inputs.notes[1]
        result = evaluate(inputs.estimate, inputs.reference, "se3")
        assert float(result.ate.translation_m.max()) < 1e-9
        relative = np.linalg.inv(inputs.reference.world_from_cam[0]) @ (
            inputs.reference.world_from_cam
        )
        expected = np.linalg.inv(poses[0]) @ np.stack(poses)
        np.testing.assert_allclose(relative, expected, atol=1e-9)


def test_ground_truth_of_nerf(tmp_path: Path) -> None:
    poses = _camera_path()
    matrices = [(pose @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist() for pose in poses]
    order = (5, 3, 0, 1, 2, 4)
    frames = [{"file_path": f"images/{i}.png", "transform_matrix": matrices[i]} for i in order]
    run = run_folder(tmp_path / "run")
    written(run / "trajectory.tum", _tum(poses))
    path = written(tmp_path / "transforms.json", json.dumps({"fl_x": 500, "frames": frames}))
    inputs = load_inputs(run, path)
    assert "row by row" in inputs.notes[0]
    np.testing.assert_allclose(inputs.reference.world_from_cam, np.stack(poses), atol=1e-12)
    np.testing.assert_array_equal(inputs.estimate.stamps_ns, inputs.reference.stamps_ns)


def test_poses_without_stamps_are_paired_by_frame_numbers(tmp_path: Path) -> None:
    """A run that lost two of eight frames, and ground truth with a pose of each frame."""
    run = run_folder(tmp_path / "run", {"mode": "stereo", "frames": 8, "start": 0, "stride": 1})
    frames = (0, 1, 4, 5, 6, 7)
    rows = [f"{frame},{i}500000000,0,0,0,1,2" for i, frame in enumerate(frames)]
    written(run / "poses.csv", "frame,stamp_ns,segment,keyframe\n" + "\n".join(rows) + "\n")
    poses = "".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0\n" for i in range(8))
    truth = written(tmp_path / "poses.txt", poses)
    inputs = load_inputs(run, truth)
    assert inputs.reference.positions[:, 0].tolist() == list(frames)
    np.testing.assert_array_equal(inputs.estimate.stamps_ns, inputs.reference.stamps_ns)
    assert "6 of 8 poses of the ground truth, by the numbers of frames" in inputs.notes[0]
    for change in ({"frames": 9}, {"start": 1}, {"stride": 2}):
        summary = {"mode": "stereo", "frames": 8, "start": 0, "stride": 1} | change
        (run / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
        with pytest.raises(EvaluationError, match="the numbers of poses differ"):
            load_inputs(run, truth)
