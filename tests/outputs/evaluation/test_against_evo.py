"""Comparison with evo, on random trajectories and on evo's own test files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vo.base.types import Trajectory
from vo.outputs.evaluation.association import nearest_pairs
from vo.outputs.evaluation.evaluation import evaluate
from vo.outputs.evaluation.pose_errors import Statistics
from vo.recordings.formats.trajectory import read_trajectory

MakeWalk = Callable[..., Trajectory]
ALIGN = {
    "none": {},
    "se3": {"align": True},
    "sim3": {"align": True, "correct_scale": True},
    "scale": {"correct_scale": True},
}


def as_evo(trajectory: Trajectory) -> Any:
    from evo.core.trajectory import PoseTrajectory3D

    seconds = trajectory.stamps_ns / 1e9
    return PoseTrajectory3D(poses_se3=list(trajectory.world_from_cam), timestamps=seconds)


def assert_same(ours: Statistics, theirs: dict[str, float]) -> None:
    for name, value in ours.to_dict().items():
        assert value == pytest.approx(theirs[name], abs=1e-6, rel=0), name


@pytest.mark.parametrize("align", ALIGN)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_ape_equals_that_of_evo(
    make_walk: MakeWalk, make_noisy: MakeWalk, align: str, seed: int
) -> None:
    from evo.core.metrics import PoseRelation
    from evo.main_ape import ape

    true = make_walk(seed=seed)
    estimate = make_noisy(true, seed=seed)
    ours = evaluate(estimate, true, align)  # type: ignore[arg-type]
    for relation, statistics in (
        (PoseRelation.translation_part, ours.ate.translation),
        (PoseRelation.rotation_angle_deg, ours.ate.rotation),
    ):
        assert_same(statistics, ape(as_evo(true), as_evo(estimate), relation, **ALIGN[align]).stats)


@pytest.mark.parametrize("align", ["se3", "sim3"])
@pytest.mark.parametrize(("delta", "unit"), [(1, "f"), (5, "f"), (3.0, "m"), (10.0, "m")])
def test_rpe_equals_that_of_evo(
    make_walk: MakeWalk, make_noisy: MakeWalk, align: str, delta: float, unit: str
) -> None:
    from evo.core.metrics import PoseRelation, Unit
    from evo.main_rpe import rpe

    true = make_walk()
    estimate = make_noisy(true)
    over = {"delta_frames": int(delta)} if unit == "f" else {"delta_m": delta}
    ours = evaluate(estimate, true, align, **over)  # type: ignore[arg-type]
    errors = ours.rpe_frames if unit == "f" else ours.rpe_metres
    assert errors is not None
    for relation, statistics in (
        (PoseRelation.translation_part, errors.translation),
        (PoseRelation.rotation_angle_deg, errors.rotation),
    ):
        theirs = rpe(
            as_evo(true),
            as_evo(estimate),
            relation,
            delta=delta,
            delta_unit=Unit.frames if unit == "f" else Unit.meters,
            all_pairs=True,
            **ALIGN[align],
        )
        assert_same(statistics, theirs.stats)


@pytest.mark.parametrize("longer", ["estimate", "reference"])
def test_association_equals_that_of_evo(longer: str) -> None:
    from evo.core.sync import matching_time_indices

    rng = np.random.default_rng(0)
    few, many = (np.sort(rng.integers(0, 10**10, size=n)) for n in (60, 300))
    theirs = matching_time_indices(few / 1e9, many / 1e9, 0.01)
    pairs = (few, many) if longer == "reference" else (many, few)
    ours = nearest_pairs(*pairs, 10_000_000)
    if longer == "estimate":
        ours = ours[::-1]
    expected = {many_row: few_row for few_row, many_row in zip(*theirs, strict=True)}
    assert set(zip(*ours, strict=True)) <= set(zip(*theirs, strict=True))
    assert len(ours[0]) == len(expected)


@pytest.mark.parametrize(
    ("estimate", "reference", "align", "heading"),
    [
        ("KITTI_00_ORB", "KITTI_00_gt", "none", "KITTI_00_ORB.txt"),
        ("KITTI_00_ORB", "KITTI_00_gt", "se3", "KITTI_00_ORB.txt -a"),
        ("KITTI_00_ORB", "KITTI_00_gt", "sim3", "KITTI_00_ORB.txt -as"),
        ("freiburg1_xyz-rgbdslam", "freiburg1_xyz-groundtruth", "se3", "rgbdslam.txt -a"),
        ("freiburg1_xyz-ORB_kf_mono", "freiburg1_xyz-groundtruth", "sim3", "ORB_kf_mono.txt -as"),
    ],
)
def test_ape_of_reference_files_equals_printed_numbers(
    shared_data: Path, estimate: str, reference: str, align: str, heading: str
) -> None:
    folder = shared_data / "eval_reference"
    true = read_trajectory(folder / f"{reference}.txt")
    ours = evaluate(read_trajectory(folder / f"{estimate}.txt"), true, align)  # type: ignore[arg-type]
    assert_same(ours.ate.translation, printed_numbers(folder, "evo_ape", reference, heading))


def test_rpe_of_reference_files_equals_printed_numbers(shared_data: Path) -> None:
    folder = shared_data / "eval_reference"
    true = read_trajectory(folder / "KITTI_00_gt.txt")
    ours = evaluate(read_trajectory(folder / "KITTI_00_ORB.txt"), true, "se3", delta_m=100.0)
    assert ours.rpe_frames is not None
    assert ours.rpe_metres is not None
    over_frames = printed_numbers(folder, "evo_rpe", "KITTI_00_gt", "-d 1 -u f")
    over_metres = printed_numbers(folder, "evo_rpe", "KITTI_00_gt", "-d 100 -u m --all_pairs")
    assert_same(ours.rpe_frames.translation, over_frames)
    assert_same(ours.rpe_metres.translation, over_metres)


def test_rotation_errors_of_reference_files_equal_those_of_evo(shared_data: Path) -> None:
    from evo.core.metrics import PoseRelation
    from evo.main_ape import ape

    folder = shared_data / "eval_reference"
    true = read_trajectory(folder / "KITTI_00_gt.txt")
    estimate = read_trajectory(folder / "KITTI_00_ORB.txt")
    theirs = ape(as_evo(true), as_evo(estimate), PoseRelation.rotation_angle_deg, align=True)
    assert_same(evaluate(estimate, true, "se3").ate.rotation, theirs.stats)


def printed_numbers(folder: Path, command: str, reference: str, ending: str) -> dict[str, float]:
    """Numbers printed below the heading with this command, reference and ending."""
    blocks = (folder / "evo_reference_numbers.txt").read_text(encoding="utf-8").split("###")
    for block in blocks:
        heading, _, body = block.strip().partition("\n")
        is_ours = heading.startswith(f"{command} ") and f"{reference}.txt" in heading
        if is_ours and heading.endswith(ending):
            return {name: float(value) for name, value in map(str.split, body.splitlines())}
    raise AssertionError(f"no {command} {reference} {ending} in the file")
