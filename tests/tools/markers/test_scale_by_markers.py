"""The scale of a mono path by markers, simulated and in whole runs."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rrd import read_rrd
from typer.testing import CliRunner

from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import inverse, make_transform, rotation_angle, se3_exp, so3_exp
from vo.base.types import Camera, Floats, Trajectory
from vo.cli.app import app
from vo.engine.markers.marker_problem import MarkerProblem, MarkerState, MarkerView, square_points
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source
from vo.tools.markers.moved import fit_unmoved
from vo.tools.markers.plane_pose import plane_pose
from vo.tools.markers.scale_fit import ScaleFit, fit_scale

LENGTH_M = 0.16
CAMERA = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
FACING = so3_exp(np.array([np.pi, 0.0, 0.0]))  # towards a camera that looks along z
FRAMES, STEP_NS = 24, 80_000_000


def _views(
    rng: np.random.Generator,
    units: float,
    corner_px: float,
    drift: float,
    span_m: float = 1.0,
    jump_m: float = 0.0,
) -> tuple[list[MarkerView], Floats, Floats]:
    """Views of a marker from a moving camera; poses of an odometry that drifts; the true marker."""
    tilt = so3_exp(rng.normal(0.0, 0.3, 3))
    marker = make_transform(FACING @ tilt, np.array([0.1, rng.uniform(-0.2, 0.2), 2.2]))
    direction = rng.normal(size=3) * (1.0, 1.0, 0.5)
    direction /= np.linalg.norm(direction)
    walk, views, poses = np.zeros(6), [], []
    sigma = max(corner_px, 0.01)
    for n in range(FRAMES):
        share = n / (FRAMES - 1)
        bend = 0.03 * np.array([np.sin(5 * share), np.cos(4 * share), np.sin(3 * share)])
        turn = so3_exp(np.array([0.05 * np.sin(3 * share), 0.1 * share, 0.02 * share]))
        true = make_transform(turn, direction * span_m * (share - 0.5) + min(span_m, 1.0) * bend)
        pose = true.copy()
        pose[:3, 3] *= units
        walk += np.concatenate([rng.normal(0, 3e-4, 3), rng.normal(0, 8e-4 * units, 3)]) * drift
        if n == FRAMES // 2:
            marker[0, 3] += jump_m
        seen = inverse(true) @ marker
        points = square_points(LENGTH_M) @ seen[:3, :3].T + seen[:3, 3]
        pixels = points[:, :2] / points[:, 2:] * 600.0 + (319.5, 239.5)
        pixels = pixels + rng.normal(0.0, corner_px, (4, 2))
        if pixels.min() < 0 or (pixels > (639, 479)).any():
            continue
        found = plane_pose(CAMERA, square_points(LENGTH_M), pixels, sigma)
        assert found is not None
        solutions = (found.cam_from_marker, *([] if found.other is None else [found.other]))
        rays = (pixels - (319.5, 239.5)) / 600.0
        sigmas = np.full(2, sigma / 600.0)
        views.append(MarkerView(n, n * STEP_NS, 3, rays, sigmas, solutions, np.eye(4), LENGTH_M))
        poses.append(pose @ se3_exp(walk))
    return views, np.array(poses), marker


def _fit(views: list[MarkerView], poses: Floats, *, is_metric: bool = False) -> ScaleFit:
    fit = fit_scale(views, poses, is_metric=is_metric)
    assert fit is not None
    return fit


def test_exact_views_give_the_exact_scale_and_marker() -> None:
    views, poses, marker = _views(np.random.default_rng(0), 0.4, 0.0, 0.0)
    fit = _fit(views, poses)
    assert fit.metres_per_unit == pytest.approx(1.0 / 0.4, rel=1e-9)
    (placed,) = fit.markers
    np.testing.assert_allclose(placed.world_from_marker, marker, atol=1e-8)
    assert (placed.views, placed.first_frame, placed.last_frame) == (24, 0, 23)
    assert fit.relative_sigma == pytest.approx(0.0035, abs=0.0015)  # the size of the path itself


def test_a_wrong_solution_of_some_views_does_not_matter() -> None:
    views, poses, marker = _views(np.random.default_rng(1), 2.0, 0.0, 0.0)
    flipped = [
        view._replace(solutions=view.solutions[::-1]) if n % 3 == 0 else view
        for n, view in enumerate(views)
    ]
    fit = _fit(flipped, poses)
    assert fit.metres_per_unit == pytest.approx(0.5, rel=1e-6)
    turned = rotation_angle(fit.markers[0].world_from_marker[:3, :3] @ marker[:3, :3].T)
    assert turned < 1e-5


def _bound(seed: int, units: float, span_m: float) -> float:
    """Cramer-Rao bound of the variance of the logarithm of the scale.

    The corners have errors of a standard deviation each, and the poses those of the random walk of
    `_views`, which adds to the covariance of the corners.
    """
    rng = np.random.default_rng(seed)
    rng.uniform()  # as for the units
    views, poses, marker = _views(rng, units, 0.05, 0.0, span_m)
    problem = MarkerProblem(views, poses, [3])
    state = MarkerState(units, marker[None, :3, :3], units * marker[None, :3, 3])
    found = problem._linearise(state)
    assert found is not None
    steps = np.r_[np.full(3, 3e-4), np.full(3, 8e-4 * units)]
    walk = np.zeros((len(views), 8, len(views), 6))
    for k in range(len(views)):
        walk[k:, :, k] = found.by_camera[k:] * steps
    by_walk = walk.reshape(len(found.residual), -1)
    covariance = np.eye(len(by_walk)) + by_walk @ by_walk.T
    information = found.jacobian.T @ np.linalg.solve(covariance, found.jacobian)
    return float(np.linalg.inv(information)[-1, -1])


@pytest.mark.parametrize(("span_m", "bound"), [(1.0, 0.0046), (0.4, 0.0115)])
def test_the_stated_sigma_covers_the_truth_and_the_error_is_near_its_bound(
    span_m: float, bound: float
) -> None:
    errors, sigmas, bounds = [], [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        units = float(np.exp(rng.uniform(-1.0, 1.0)))
        views, poses, _ = _views(rng, units, 0.05, 1.0, span_m)
        fit = _fit(views, poses)
        errors.append(np.log(fit.metres_per_unit * units))
        sigmas.append(fit.relative_sigma)
        bounds.append(_bound(seed, units, span_m))
    covered = np.sum(np.abs(errors) < 1.96 * np.array(sigmas))
    assert covered >= 36
    error = float(np.sqrt(np.mean(np.square(errors))))
    assert error > 0.5 * np.mean(sigmas)  # and is not idle
    assert np.sqrt(np.mean(bounds)) == pytest.approx(bound, rel=0.05)
    assert error < 1.3 * bound


@pytest.mark.parametrize("is_metric", [False, True])
def test_a_marker_that_was_moved_is_named_and_bends_no_scale(is_metric: bool) -> None:
    for seed in range(10):
        units = 1.0 if is_metric else 0.4
        still, poses, _ = _views(np.random.default_rng(seed), units, 0.05, 1.0)
        moved, again, _ = _views(np.random.default_rng(seed), units, 0.05, 1.0, jump_m=0.3)
        others = [view._replace(id=5) for view in still]
        along = np.cumsum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0, prepend=0), axis=1))
        _, notes = fit_unmoved(still, poses, along, is_metric=is_metric)
        assert notes == []
        along = np.r_[along, along[[view.frame_index for view in moved]]]
        fit, notes = fit_unmoved(
            [*others, *moved], np.concatenate([poses, again]), along, is_metric=is_metric
        )
        assert len(notes) == 1 and "marker 3 " in notes[0], seed
        assert fit is not None
        assert abs(np.log(fit.metres_per_unit * units)) < 4.0 * fit.relative_sigma


def test_a_camera_that_stands_still_says_that_it_knows_nothing() -> None:
    views, poses, _ = _views(np.random.default_rng(2), 0.7, 0.05, 1.0, span_m=0.002)
    fit = fit_scale(views, poses, is_metric=False)
    assert fit is None or fit.relative_sigma > 0.1


def _summary(folder: Path) -> dict[str, Any]:
    found = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


def _scale_to(truth: Trajectory, path: Path) -> float:
    """Scale that aligns a path with the truth, 1 for a path in metres."""
    estimate = read_tum(path)
    _, mine, theirs = np.intersect1d(
        estimate.stamps_ns, truth.stamps_ns, return_indices=True, assume_unique=True
    )
    assert len(mine) > 20
    found = umeyama(estimate.positions[mine], truth.positions[theirs], with_scale=True)
    return float(found.scale)


def test_a_marker_in_view_gives_a_mono_run_in_metres(
    with_marker: Path, hanging: Floats, tmp_path: Path
) -> None:
    output, rrd = tmp_path / "out", tmp_path / "run.rrd"
    words = ["run", str(with_marker), "-o", str(output), "--mode", "mono", "--config", "fast"]
    result = CliRunner().invoke(app, [*words, "--markers", "0.16", "--rrd", str(rrd)])
    assert result.exit_code == 0, result.output
    summary = _summary(output)
    assert summary["length_unit"] == "m"
    (scale,) = summary["scales"]
    assert scale["source"] == "markers 7"
    assert scale["sigma"] / scale["value"] < 0.02
    truth = read_tum(with_marker / "groundtruth.tum")
    assert _scale_to(truth, output / "trajectory.tum") == pytest.approx(1.0, abs=0.01)
    (row,) = csv.DictReader((output / "markers.csv").read_text().splitlines())
    assert row["id"] == "7" and int(row["views"]) >= 10
    assert 1.0 < float(row["tz"]) < 4.0
    _check_recording(rrd, row, scale["value"], with_marker, hanging)


def _check_recording(
    rrd: Path, row: dict[str, str], metres: float, source: Path, hanging: Floats
) -> None:
    """The outlines are where the marker was rendered, and the square is in units of the map."""
    outlines = dict(read_rrd(rrd, "strips")["world/cam0/left/markers"])
    labels = dict(read_rrd(rrd, "labels")["world/cam0/left/markers"])
    shown = [frame for frame, strips in outlines.items() if strips]
    assert len(shown) >= 10 and all(labels[frame] == ["7"] for frame in shown)
    last = max(shown)
    assert outlines[last + 1] == []  # it ends with its frame
    truth = read_tum(source / "groundtruth.tum").world_from_cam
    camera = open_source(source, mode="mono").rig.cam0
    seen = inverse(truth[last]) @ truth[len(truth) // 2] @ hanging
    points = square_points(LENGTH_M) @ seen[:3, :3].T + seen[:3, 3]
    pixels = points[:, :2] / points[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    drawn = 2.0 * np.array(outlines[last][0])[:4] - 0.5  # images are recorded at half their size
    np.testing.assert_allclose(drawn, pixels, atol=0.5)
    (
        (
            first,
            ((square,)),
        ),
    ) = read_rrd(rrd, "strips")["world/markers/0/7"]
    assert first == int(row["first_frame"])
    middle = metres * np.array(square)[:4].mean(axis=0)
    np.testing.assert_allclose(middle, [float(row[name]) for name in ("tx", "ty", "tz")], rtol=1e-4)
    sides = np.linalg.norm(np.diff(square, axis=0), axis=1)
    np.testing.assert_allclose(metres * sides, LENGTH_M, rtol=1e-4)


def test_a_run_without_a_marker_says_so(synthetic_stereo: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    words = ["run", str(synthetic_stereo), "-o", str(output), "--mode", "mono", "--end", "12"]
    result = CliRunner().invoke(app, [*words, "--config", "fast", "--markers", "0.16"])
    assert result.exit_code == 0, result.output
    summary = _summary(output)
    assert summary["length_unit"] == "map units"
    assert any("no marker of any dictionary was seen" in text for text in summary["warnings"])


def test_a_length_in_millimetres_is_refused_before_the_run(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    output = tmp_path / "out"
    words = ["run", str(synthetic_stereo), "-o", str(output), "--markers", "160"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1
    assert "metres, not millimetres: 0.16" in result.stderr
    assert not output.exists()
    words[-2:] = ["--marker-dictionary", "tag36h11"]
    result = CliRunner().invoke(app, words)
    assert "--marker-dictionary is for --markers" in result.stderr
    words[-2:] = ["--markers", "0,16"]
    result = CliRunner().invoke(app, words)
    assert "0,16 cannot be read" in result.stderr and "such as 0.16" in result.stderr


def test_the_world_can_be_that_of_a_marker(
    with_marker: Path, hanging: Floats, tmp_path: Path
) -> None:
    truth = read_tum(with_marker / "groundtruth.tum")
    output = tmp_path / "out"
    words = ["run", str(with_marker), "-o", str(output), "--config", "fast", "--markers", "0.16"]
    result = CliRunner().invoke(app, [*words, "--end", "15", "--world", "marker:7"])
    assert result.exit_code == 0, result.output
    (row,) = csv.DictReader((output / "markers.csv").read_text().splitlines())
    assert [float(row[name]) for name in ("tx", "ty", "tz", "qw")] == pytest.approx([0, 0, 0, 1])
    estimate = read_tum(output / "trajectory.tum")
    marker = truth.world_from_cam[len(truth) // 2] @ hanging
    number = int(np.flatnonzero(truth.stamps_ns == estimate.stamps_ns[5])[0])
    expected = inverse(marker) @ truth.world_from_cam[number]
    np.testing.assert_allclose(estimate.positions[5], expected[:3, 3], atol=0.02)
    absent = CliRunner().invoke(app, [*words, "--end", "12", "--world", "marker:9", "--json"])
    assert "marker 9 has no pose in the path" in " ".join(_summary(output)["warnings"])
    assert absent.exit_code == 0
    wrong = CliRunner().invoke(app, [*words, "--world", "tag 7"])
    assert "--world is 'tag 7'; give marker:ID" in wrong.stderr


def test_a_wrong_marker_contradicts_a_stereo_run(with_marker: Path, tmp_path: Path) -> None:
    words = ["run", str(with_marker), "-o", str(tmp_path / "out"), "--config", "fast", "--json"]
    result = CliRunner().invoke(app, [*words, "--markers", "0.2", "--marker-dictionary", "4X4_50"])
    assert result.exit_code == 0, result.output
    warnings = _summary(tmp_path / "out")["warnings"]
    assert any("by the markers of 200 mm all lengths would be +2" in text for text in warnings)
