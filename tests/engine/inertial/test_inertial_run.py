"""Runs of one camera with an inertial sensor."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from sensor_faults import Change, added, scaled

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from data_synth.writers import euroc
from vo.base.config import load_config
from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import adjoint, inverse, se3_log
from vo.base.types import Estimate, Floats, State
from vo.outputs.evaluation.association import tracked_part
from vo.outputs.evaluation.inputs import load_inputs
from vo.outputs.evaluation.pose_errors import absolute_errors
from vo.outputs.streaming.sink import PoseUpdate
from vo.recordings.formats.trajectory import read_tum
from vo.runs.run_recording import run

GYRO_BIAS, ACCEL_BIAS = np.array([0.02, -0.03, 0.01]), np.array([0.1, -0.1, 0.2])
BLACK = slice(66, 78)
MAX_SEARCH = (
    6  # frames after it until the camera has a pose by a new map, if the old one is not found
)
FILES = ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv")


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight seconds by hand through a room, one camera of 353 x 226 pixels, as EuRoC."""
    settings = ["motion=handheld", "seconds=8", "fps=12", "scale=0.47", "mono=true", "seed=4"]
    plan = make_plan(load_recipe(None, settings))
    assert plan.recording.imu is not None
    imu = plan.recording.imu
    imu = replace(imu, gyro=imu.gyro + GYRO_BIAS, accel=imu.accel + ACCEL_BIAS)
    plan = replace(plan, recording=replace(plan.recording, imu=imu))
    folder = tmp_path_factory.mktemp("inertial") / "walk"
    with ThreadPoolExecutor() as pool:
        shots = render_frames(plan, pool, range(len(plan.recording.stamps_ns[0])))
        euroc.write(folder, plan.recording, shots, "png")
    return folder


def _run(recording: Path, output: Path, *settings: str, **options: Any) -> dict[str, Any]:
    config = load_config(overrides=settings)
    return run(recording, output, config=config, **options).to_dict()


@pytest.fixture(scope="module")
def inertial(walk: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    output = tmp_path_factory.mktemp("inertial_run")
    return output, _run(walk, output)


@pytest.fixture(scope="module")
def visual(walk: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    output = tmp_path_factory.mktemp("visual_run")
    return output, _run(walk, output, "inertial.enabled=false")


def _poses(output: Path, recording: Path, name: str = "trajectory.tum") -> tuple[Floats, Floats]:
    """Estimated and true poses at the same times."""
    found, truth = read_tum(output / name), read_tum(recording / "groundtruth.tum")
    rows = np.searchsorted(truth.stamps_ns, found.stamps_ns - 1000)
    return found.world_from_cam, truth.world_from_cam[rows]


def _scale_error(output: Path, recording: Path) -> float:
    found, truth = _poses(output, recording)
    return abs(1.0 / umeyama(found[:, :3, 3], truth[:, :3, 3], with_scale=True).scale - 1.0)


def test_lengths_are_metres(inertial: tuple[Path, dict[str, Any]], walk: Path) -> None:
    output, summary = inertial
    assert summary["length_unit"] == "m" and summary["verdict"].startswith("complete")
    assert not [w for w in summary["warnings"] if "scale" in w]
    assert _scale_error(output, walk) < 0.01
    found, truth = _poses(output, walk)
    fit = umeyama(found[:, :3, 3], truth[:, :3, 3], with_scale=False)
    aligned = found.copy()
    aligned[:, :3, :3] = fit.rotation @ found[:, :3, :3]
    aligned[:, :3, 3] = found[:, :3, 3] @ fit.rotation.T + fit.translation
    length = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum()
    assert absolute_errors(aligned, truth).translation.rmse < 0.005 * length


def test_world_is_upright(inertial: tuple[Path, dict[str, Any]], walk: Path) -> None:
    found, truth = _poses(inertial[0], walk)
    up = (found[:, :3, :3] @ np.swapaxes(truth[:, :3, :3], 1, 2))[:, 2, 2]
    assert np.degrees(np.arccos(np.clip(up, -1.0, 1.0))).max() < 0.5
    np.testing.assert_allclose(found[0, :3, 3], 0.0, atol=2e-3)
    assert found[0, 0, 2] > 0.5 and abs(found[0, 1, 2]) < 0.01  # looks along x


def test_states_are_reported_with_their_errors(
    inertial: tuple[Path, dict[str, Any]], walk: Path
) -> None:
    use = inertial[1]["inertial"]
    assert use["reason"] is None and use["metric_worlds"] == [0] and 0 < use["first_frame"] < 90
    states = use["states"]
    assert 0.0 < states["scale_sigma"] < 0.02 and states["tilt_sigma_deg"] < 0.3
    table = np.loadtxt(
        walk / "mav0/state_groundtruth_estimate0/data.csv", delimiter=",", comments="#"
    )
    gyro_error = states["gyro_bias_rad_s"] - table[-1, 11:14] - GYRO_BIAS
    accel_error = states["accel_bias_m_s2"] - table[-1, 14:17] - ACCEL_BIAS
    assert np.linalg.norm(gyro_error) < 0.05 * np.linalg.norm(GYRO_BIAS)
    assert (np.abs(accel_error) < 4 * np.array(states["accel_bias_sigma_m_s2"])).all()


def test_causal_path_is_metric_from_the_first_states_on(
    inertial: tuple[Path, dict[str, Any]], walk: Path
) -> None:
    output, summary = inertial
    found, truth = _poses(output, walk, "causal.tum")
    late = read_tum(output / "causal.tum").stamps_ns
    first = read_tum(walk / "groundtruth.tum").stamps_ns[summary["inertial"]["first_frame"] + 15]
    rows = late > first
    scale = umeyama(found[rows, :3, 3], truth[rows, :3, 3], with_scale=True).scale
    assert abs(scale - 1.0) < 0.03


def test_runs_are_repeatable(
    inertial: tuple[Path, dict[str, Any]], walk: Path, tmp_path: Path
) -> None:
    _run(walk, tmp_path / "out", "threads=1")
    for name in FILES:
        assert (tmp_path / "out" / name).read_bytes() == (inertial[0] / name).read_bytes(), name


def test_without_the_sensor_the_scale_is_unknown(visual: tuple[Path, dict[str, Any]]) -> None:
    summary = visual[1]
    assert "inertial" not in summary and summary["length_unit"] == "map units"
    assert any("the scale is unknown" in warning for warning in summary["warnings"])


def test_right_time_offset_is_confirmed(inertial: tuple[Path, dict[str, Any]]) -> None:
    use = inertial[1]["inertial"]
    assert abs(use["time_offset_s"]) < min(0.001, 4.0 * use["time_offset_sigma_s"])
    assert use["used_time_offset_s"] == use["given_time_offset_s"] == 0.0


def test_wrong_time_offset_is_found_used_and_told(walk: Path, tmp_path: Path) -> None:
    recording = tmp_path / "walk"
    shutil.copytree(walk, recording)
    table = recording / "mav0/imu0/data.csv"
    lines = table.read_text().splitlines()
    changed = [
        f"{int(line.split(',')[0]) - 40_000_000},{line.split(',', 1)[1]}" for line in lines[1:]
    ]
    table.write_text("\n".join([lines[0], *changed]) + "\n")
    summary = _run(recording, tmp_path / "out")
    use = summary["inertial"]
    # By windows of other sizes 0.1 to 1.4 ms, with a stated standard deviation of 1.5 ms.
    assert abs(use["time_offset_s"] + 0.04) < min(0.002, 2.0 * use["time_offset_sigma_s"])
    assert use["used_time_offset_s"] == use["time_offset_s"] and use["given_time_offset_s"] == 0.0
    told = [w for w in summary["warnings"] if "were added to stamps of images" in w]
    assert len(told) == 1 and "not +0.0 ms as given" in told[0]
    assert summary["length_unit"] == "m" and _scale_error(tmp_path / "out", walk) < 0.01


def test_stamps_of_images_that_vary_do_not_contradict_the_sensor(
    shared_data: Path, tmp_path: Path
) -> None:
    hall = shared_data / "rendered_hall_stereo/mav0"
    late_ns = np.rint(2e6 * np.random.default_rng(3).standard_normal(1000)).astype(int)
    for camera in ("cam0", "cam1"):
        folder = tmp_path / "hall/mav0" / camera
        folder.mkdir(parents=True)
        (folder / "data").symlink_to(hall / camera / "data")
        (folder / "sensor.yaml").symlink_to(hall / camera / "sensor.yaml")
        head, *rows = (hall / camera / "data.csv").read_text().splitlines()
        moved = [
            f"{int(row.split(',')[0]) + by},{row.split(',')[1]}"
            for row, by in zip(rows, late_ns[: len(rows)], strict=True)
        ]
        (folder / "data.csv").write_text("\n".join([head, *moved]) + "\n")
    (tmp_path / "hall/mav0/imu0").symlink_to(hall / "imu0")
    summary = _run(tmp_path / "hall", tmp_path / "out")
    assert not summary["faults"] and summary["inertial"]["states"]["misfit"] < 0.7
    assert summary["inertial"]["stamp_sigma_s"] == pytest.approx(0.002, rel=0.15)
    assert any("stamps of images vary by" in warning for warning in summary["warnings"])


def _in_g(row: list[str]) -> list[str]:
    return row[:4] + [repr(float(v) / 9.80665) for v in row[4:7]]


def _late(row: list[str]) -> list[str]:
    return [str(int(row[0]) + 60_000_000_000), *row[1:]]


def _flipped(row: list[str]) -> list[str]:
    return [row[0], row[1], repr(-float(row[2])), repr(-float(row[3])), *row[4:]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_in_g, "probably in g"),
        (_late, "covers 0 % of the images"),
        (_flipped, "rotations by images and by the gyroscope differ"),
    ],
)
def test_a_wrong_sensor_is_told_and_images_alone_are_used(
    change: Callable[[list[str]], list[str]],
    words: str,
    walk: Path,
    visual: tuple[Path, dict[str, Any]],
    tmp_path: Path,
) -> None:
    recording = tmp_path / "walk"
    shutil.copytree(walk, recording)
    table = recording / "mav0/imu0/data.csv"
    lines = table.read_text().splitlines()
    changed = [",".join(change(line.split(","))) for line in lines[1:]]
    table.write_text("\n".join([lines[0], *changed]) + "\n")
    summary = _run(recording, tmp_path / "out")
    told = [w for w in summary["warnings"] if words in w]
    assert len(told) == 1 and "\n" not in told[0] and "only the images are" in told[0]
    assert summary["length_unit"] == "map units"
    for name in FILES:
        assert (tmp_path / "out" / name).read_bytes() == (visual[0] / name).read_bytes(), name


def _with_samples(recording: Path, copy: Path, change: Change) -> Path:
    """A copy with changed samples."""
    shutil.copytree(recording, copy)
    table = copy / "mav0/imu0/data.csv"
    heading, *lines = table.read_text().splitlines()
    stamps = [line.split(",")[0] for line in lines]
    values = np.array([[float(v) for v in line.split(",")[1:7]] for line in lines])
    values = change(1e-9 * (np.array(stamps, np.int64) - int(stamps[0])), values)
    rows = [",".join(map(repr, row)) for row in values.tolist()]
    lines = [f"{stamp},{row}" for stamp, row in zip(stamps, rows, strict=True)]
    table.write_text("\n".join([heading, *lines]) + "\n")
    return copy


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (added([0.0, 0.0, 0.0, 35.0, 0.0, 0.0], 4.0, 5.0), "times their noise"),
        (added([0.0, 0.0, 0.0, 0.0, 1.0, 0.0], 4.0, 99.0), "times their noise"),
        (scaled(1.0, 1.1), "9.81 m/s²"),
    ],
)
def test_a_sensor_that_contradicts_the_images_leaves_no_trace(
    change: Change,
    words: str,
    walk: Path,
    visual: tuple[Path, dict[str, Any]],
    tmp_path: Path,
) -> None:
    estimates = _Estimates()
    recording = _with_samples(walk, tmp_path / "walk", change)
    summary = _run(recording, tmp_path / "out", poses=[estimates])
    for name in FILES:
        assert (tmp_path / "out" / name).read_bytes() == (visual[0] / name).read_bytes(), name
    told = [w for w in summary["warnings"] if words in w]
    assert len(told) == 1 and "only the images are" in told[0]
    assert len(summary["warnings"]) == len(visual[1]["warnings"]) + 1
    (fault,) = summary["faults"]
    assert fault["kind"] == "inertial_contradiction" and fault["is_handled"]
    assert summary["trusted"] and summary["length_unit"] == "map units"
    assert summary["inertial"]["states"] is None and summary["frames"] == 96
    assert [e.frame_index for e in estimates.found] == [*range(96), *range(96)]


def test_one_corrupt_sample_makes_no_difference(
    walk: Path, inertial: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    change = added([30.0, -30.0, 30.0, 150.0, -150.0, 150.0], 3.999, 4.001)
    summary = _run(_with_samples(walk, tmp_path / "walk", change), tmp_path / "out")
    assert summary["length_unit"] == "m" and not summary["faults"]
    assert _scale_error(tmp_path / "out", walk) < 0.01
    up = [each["inertial"]["states"]["up"] for each in (summary, inertial[1])]
    assert np.dot(*up) > np.cos(np.radians(0.2))


def _path_error(output: Path, recording: Path) -> float:
    """Root mean square error of the positions in metres, aligned by a rigid motion."""
    path, truth = _poses(output, recording, "trajectory.tum")
    positions = truth[:, :3, 3]
    fit = umeyama(path[:, :3, 3], positions, with_scale=False)
    off = fit.transform_points(path[:, :3, 3]) - positions
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def test_two_cameras_are_as_accurate_with_a_sensor(synthetic_stereo: Path, tmp_path: Path) -> None:
    with_imu = _run(synthetic_stereo, tmp_path / "with")
    without = _run(synthetic_stereo, tmp_path / "without", "inertial.enabled=false")
    assert with_imu["inertial"]["sensor"] and "inertial" not in without
    causal = [(tmp_path / name / "causal.tum").read_bytes() for name in ("with", "without")]
    assert causal[0] == causal[1]
    moved = [_path_error(tmp_path / name, synthetic_stereo) for name in ("with", "without")]
    assert moved[0] <= 1.1 * moved[1] + 0.001 and moved[0] != moved[1]


def test_rendered_hall_is_metric(shared_data: Path, tmp_path: Path) -> None:
    recording = shared_data / "rendered_hall_stereo"
    summary = _run(recording, tmp_path, mode="mono")
    assert summary["length_unit"] == "m"
    assert _scale_error(tmp_path, recording) < 0.01
    assert json.loads((tmp_path / "summary.json").read_text())["inertial"]["states"] is not None


@pytest.fixture(scope="module")
def dark_walk(walk: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with a second of noisy black images."""
    folder = tmp_path_factory.mktemp("dark") / "walk"
    return _darkened(walk, folder, BLACK)


def _darkened(recording: Path, copy: Path, frames: slice) -> Path:
    """A copy in which all images of some frames are black, with noise."""
    shutil.copytree(recording, copy)
    rng = np.random.default_rng(1)
    for folder in sorted(copy.glob("mav0/cam*/data")):
        for image in sorted(folder.iterdir())[frames]:
            grey = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
            assert grey is not None
            black = rng.normal(2.0, 1.5, grey.shape).clip(0, 255).astype(np.uint8)
            image.unlink()  # it may be read-only
            assert cv2.imwrite(str(image), black)
    return copy


class _Estimates:
    """Keeps the estimates of a run, and their records."""

    name = "estimates"

    def __init__(self) -> None:
        self.found: list[Estimate] = []
        self.records: list[dict[str, Any]] = []

    def send(self, update: PoseUpdate) -> None:
        self.found.append(update.estimate)
        self.records.append(json.loads(update.record))

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def dark_run(
    dark_walk: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Any], _Estimates]:
    output, estimates = tmp_path_factory.mktemp("dark_run"), _Estimates()
    return output, _run(dark_walk, output, poses=[estimates]), estimates


def test_frames_without_light_are_predicted_at_once(
    dark_walk: Path, dark_run: tuple[Path, dict[str, Any], _Estimates]
) -> None:
    output, _, estimates = dark_run
    found = estimates.found
    lost = [e.frame_index for e in found if e.predicted is not None]
    assert lost == list(range(BLACK.start, BLACK.start + len(lost)))
    assert 0 <= len(lost) - (BLACK.stop - BLACK.start) <= MAX_SEARCH
    for each in found[BLACK]:
        assert each.state is State.LOST and each.failure is not None
        assert each.world_from_cam0 is None and each.inliers == 0 and not each.is_keyframe
    causal, truth = _poses(output, dark_walk, "causal.tum")
    stamps_ns = read_tum(output / "causal.tum").stamps_ns
    assert set(stamps_ns) >= {e.stamp_ns for e in found[BLACK]}
    row = int(np.flatnonzero(stamps_ns == found[BLACK.start].stamp_ns)[0])
    rows = slice(row, row + BLACK.stop - BLACK.start)
    motion = inverse(causal[row - 1]) @ causal[rows]
    off = inverse(motion) @ inverse(truth[row - 1]) @ truth[rows]
    error = np.array([se3_log(each) for each in off])
    assert np.abs(error[:, :3]).max() < 0.008 and np.abs(error[:, 3:]).max() < 0.03
    still = np.linalg.norm((inverse(truth[row - 1]) @ truth[rows])[:, :3, 3], axis=1)
    assert still.max() > 0.3  # what is predicted is not small


def test_predicted_frames_state_a_covariance_that_grows_and_is_honest(
    dark_walk: Path, dark_run: tuple[Path, dict[str, Any], _Estimates]
) -> None:
    found = dark_run[2].found[BLACK][2:]  # with the newest keyframe optimised
    covariance = np.array([e.predicted.covariance for e in found if e.predicted is not None])
    size = np.sqrt(np.trace(covariance[:, 3:, 3:], axis1=1, axis2=2))
    assert (np.diff(size) > 0.0).all() and size[-1] > 1.2 * size[0]
    keyframe = found[0].keyframes[-1]
    assert keyframe.covariance is not None and not any(e.keyframes for e in found[1:])
    truth = read_tum(dark_walk / "groundtruth.tum")
    stamps_ns = np.array([keyframe.stamp_ns, *(e.stamp_ns for e in found)])
    true = truth.world_from_cam[np.searchsorted(truth.stamps_ns, stamps_ns - 1000)]
    poses = np.array([e.causal_pose for e in found])
    motion = inverse(keyframe.world_from_cam0) @ poses
    moved = adjoint(inverse(motion))
    of_motion = covariance - moved @ keyframe.covariance @ np.swapaxes(moved, 1, 2)
    error = [se3_log(each) for each in inverse(motion) @ inverse(true[0]) @ true[1:]]
    nees = [e @ np.linalg.solve(c, e) for e, c in zip(error, of_motion, strict=True)]
    # 99 % of a chi squared variable of six dimensions. The error of the keyframe, 6 to 8 mm by
    # windows of any size, is part of all, and of the first ones the most.
    assert 0.1 < np.median(nees) < 16.8


def test_records_have_predicted_poses_apart(
    dark_run: tuple[Path, dict[str, Any], _Estimates],
) -> None:
    records = dark_run[2].records
    lines = (dark_run[0] / "causal.tum").read_text().splitlines()
    lost = sum(record["predicted"] is not None for record in records)
    assert sum(r["world_from_cam0"] is not None for r in records) + lost == len(lines)
    for n, record in enumerate(records):
        if not BLACK.start <= n < BLACK.stop:
            assert (record["predicted"] is None) == (not BLACK.stop <= n < BLACK.start + lost)
            continue
        assert record["state"] == "lost" and record["failure"] == "image_defect"
        assert record["world_from_cam0"] is record["covariance"] is None
        numbers = record["predicted"]["position_xyz"] + record["predicted"]["quat_xyzw"]
        assert numbers in [[float(field) for field in line.split()[1:]] for line in lines]


def test_predicted_frames_are_not_counted_as_tracked(
    dark_walk: Path, dark_run: tuple[Path, dict[str, Any], _Estimates]
) -> None:
    output, summary, estimates = dark_run
    lost = sum(each.predicted is not None for each in estimates.found)
    assert summary["tracked"] == 96 - 12 and summary["verdict"] == "with gaps"
    rows = [line.split(",") for line in (output / "frames.csv").read_text().splitlines()]
    assert [row[2] for row in rows[1:]][BLACK] == ["lost"] * 12
    causal = read_tum(output / "causal.tum")
    assert len(tracked_part(causal, output)) == len(causal) - lost
    (note,) = [n for n in load_inputs(output / "causal.tum", dark_walk).notes if "predicted" in n]
    assert note.startswith(f"{lost} of {len(causal)} poses")


def test_a_second_without_light_is_bridged(
    dark_walk: Path,
    dark_run: tuple[Path, dict[str, Any], _Estimates],
    inertial: tuple[Path, dict[str, Any]],
) -> None:
    output, summary, _ = dark_run
    assert len(summary["segments"]) == 1 and summary["lost"] == summary["starting"] == 0
    assert summary["inertial_poses"] == 12 and summary["verdict"] == "with gaps"
    rows = np.loadtxt(output / "poses.csv", delimiter=",", skiprows=1)
    assert rows[:, 0].tolist() == list(range(96)) and (rows[BLACK, 4] == 2).all()
    found, truth = _poses(output, dark_walk)
    fit = umeyama(found[:, :3, 3], truth[:, :3, 3], with_scale=False)
    moved = found[:, :3, 3] @ fit.rotation.T + fit.translation
    error = np.linalg.norm(moved - truth[:, :3, 3], axis=1)
    usual, truth = _poses(inertial[0], dark_walk)
    fit = umeyama(usual[:, :3, 3], truth[:, :3, 3], with_scale=False)
    moved = usual[:, :3, 3] @ fit.rotation.T + fit.translation
    usual_m = np.linalg.norm(moved - truth[:, :3, 3], axis=1)
    assert np.sqrt((error**2).mean()) < 1.3 * np.sqrt((usual_m**2).mean()) + 0.002
    assert error[BLACK].max() < 0.04
    covariance = (output / "covariance.csv").read_text().splitlines()[1:]
    dark = [line for line in covariance if BLACK.start <= int(line.split(",")[1]) < BLACK.stop]
    assert len(dark) == 12 and all(line.split(",")[3] for line in dark)


def test_without_the_sensor_a_second_without_light_divides_the_path(
    dark_walk: Path, tmp_path: Path
) -> None:
    summary = _run(dark_walk, tmp_path / "out", "inertial.enabled=false")
    assert len(summary["segments"]) == 2 and summary["inertial_poses"] == 0
    dark = {int(image.stem) for image in sorted((dark_walk / "mav0/cam0/data").iterdir())[BLACK]}
    assert not dark & set(read_tum(tmp_path / "out" / "causal.tum").stamps_ns.tolist())


def test_a_gap_is_not_bridged_by_a_sensor_that_is_wrong_in_it(
    shared_data: Path, tmp_path: Path
) -> None:
    dark = _darkened(shared_data / "rendered_hall_stereo", tmp_path / "hall", slice(104, 128))

    def saturated(seconds: Floats, values: Floats) -> Floats:
        inside = (seconds > 5.2) & (seconds < 6.3)
        low = np.clip(values, [-0.05] * 3 + [-np.inf] * 3, [0.05] * 3 + [np.inf] * 3)
        return np.where(inside[:, None], low, values)

    wrong = _with_samples(dark, tmp_path / "wrong", saturated)
    summary = _run(wrong, tmp_path / "out")
    assert [f["kind"] for f in summary["faults"]] == ["inertial_contradiction"]
    _run(dark, tmp_path / "without", "inertial.enabled=false")
    for name in FILES:
        expected = (tmp_path / "without" / name).read_bytes()
        assert (tmp_path / "out" / name).read_bytes() == expected, name


def test_two_seconds_without_light_are_bridged_to_a_new_map_of_two_cameras(
    shared_data: Path, tmp_path: Path
) -> None:
    dark = _darkened(shared_data / "rendered_hall_stereo", tmp_path / "hall", slice(110, 150))
    summary = _run(dark, tmp_path / "out")
    assert summary["tracked"] == 160 and summary["inertial_poses"] == 40
    assert [s["frames"] for s in summary["segments"]] == [200]  # of one world
    found, truth = _poses(tmp_path / "out", dark)
    fit = umeyama(found[:, :3, 3], truth[:, :3, 3], with_scale=False)
    error = np.linalg.norm(
        found[:, :3, 3] @ fit.rotation.T + fit.translation - truth[:, :3, 3], axis=1
    )
    assert error.max() < 0.04
    rows = (tmp_path / "out" / "frames.csv").read_text().splitlines()[1:]
    assert {line.split(",")[3] for line in rows} == {"0", "1"}  # two maps
