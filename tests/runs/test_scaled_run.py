"""A mono run with a known scale: what is in metres, and what stays in units of the map."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import vo
from vo.base.config import load_config
from vo.base.geometry.geodesy import enu_from_geodetic, geodetic_from_enu
from vo.base.records.metric_scale import MetricScale, ScaleFindings
from vo.base.records.posed_frames import PosedFrames
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, Floats
from vo.cli.app import app
from vo.outputs.evaluation.evaluation import evaluate
from vo.outputs.evaluation.inputs import load_inputs
from vo.outputs.recorders.exports import Exports
from vo.recordings.formats.trajectory import read_tum
from vo.runs.run_recording import run
from vo.runs.scaling.scale_sources import ScaleOptions

FAST = load_config("fast", ["inertial.enabled=false"])
VALUE, SIGMA = 2.5, 0.05
ORIGIN = np.array([-33.9, 151.2, 40.0])


class Known:
    """A source that knows the scale of every world, or of none."""

    def __init__(self, *scales: MetricScale, note: str = "") -> None:
        self._findings = ScaleFindings(scales, (note,) if note else ())
        self.frames: list[int] = []

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        self.frames.append(estimate.frame_index)
        assert snapshot().view.image0.ndim == 2

    def measure(self, path: PosedFrames) -> ScaleFindings:
        assert set(path.world.tolist()) == {0}
        return self._findings


@pytest.fixture(scope="module")
def runs(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs without a source, with a scale, and with a source that finds none."""
    root = tmp_path_factory.mktemp("scaled")
    known = Known(MetricScale(0, VALUE, SIGMA, "test"))
    for name, sources in (
        ("plain", ()),
        ("scaled", (known,)),
        ("unknown", (Known(note="the scale cannot be seen here"),)),
    ):
        run(
            synthetic_stereo,
            root / name,
            config=FAST,
            mode="mono",
            scale_sources=sources,
            exports=Exports(ply=root / f"{name}.ply", colmap=root / f"{name}-colmap"),
        )
    assert known.frames == sorted(set(known.frames)) and known.frames[0] == 0
    return root


def summary(folder: Path) -> dict[str, Any]:
    found = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


def table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def test_the_path_is_in_metres_and_the_causal_one_is_not(runs: Path) -> None:
    plain, scaled = (read_tum(runs / n / "trajectory.tum") for n in ("plain", "scaled"))
    np.testing.assert_allclose(scaled.positions, VALUE * plain.positions, atol=5e-9)
    rotations = [p.world_from_cam[:, :3, :3] for p in (plain, scaled)]
    np.testing.assert_array_equal(*rotations)
    causal = [(runs / n / "causal.tum").read_bytes() for n in ("plain", "scaled")]
    assert causal[0] == causal[1]
    rows = table(runs / "scaled" / "poses.csv")
    positions = [[float(row[axis]) for axis in ("tx", "ty", "tz")] for row in rows]
    np.testing.assert_allclose(positions, scaled.positions, atol=1e-9)


def test_the_covariance_has_the_uncertainty_of_the_scale(runs: Path) -> None:
    plain, scaled = (table(runs / n / "covariance.csv") for n in ("plain", "scaled"))
    path = read_tum(runs / "scaled" / "trajectory.tum")
    for before, after in zip(plain, scaled, strict=True):
        pose = path.world_from_cam[path.stamps_ns == int(after["stamp_ns"])][0]
        in_cam = pose[:3, :3].T @ pose[:3, 3]
        assert float(after["c_rx_rx"]) == pytest.approx(float(before["c_rx_rx"]), rel=1e-6)
        added = (SIGMA / VALUE * in_cam[2]) ** 2
        expected = VALUE**2 * float(before["c_tz_tz"]) + added
        assert float(after["c_tz_tz"]) == pytest.approx(expected, rel=1e-5, abs=1e-12)
    assert added > 1e-6  # of the last keyframe: the test can fail


def test_the_summary_has_the_scale(runs: Path) -> None:
    plain, scaled, unknown = (summary(runs / n) for n in ("plain", "scaled", "unknown"))
    assert "scales" not in plain and plain["length_unit"] == "map units"
    assert scaled["scales"] == [{"segment": 0, "value": VALUE, "sigma": SIGMA, "source": "test"}]
    assert scaled["length_unit"] == "m"
    assert scaled["path_m"] == pytest.approx(VALUE * plain["path_m"], rel=1e-6)
    assert not any("scale" in warning for warning in scaled["warnings"])
    assert unknown["scales"] == [] and unknown["length_unit"] == "map units"
    assert "the scale cannot be seen here" in unknown["warnings"]
    assert any("the scale is unknown" in warning for warning in unknown["warnings"])
    assert unknown["path_m"] == plain["path_m"]


def test_only_the_path_in_metres_is_compared_without_scale(runs: Path) -> None:
    truth = runs / "plain" / "trajectory.tum"
    scaled = load_inputs(runs / "scaled", truth)
    assert (scaled.mode, scaled.causal_mode) == ("auto", "mono")
    assert any("in metres" in note for note in scaled.notes)
    assert load_inputs(runs / "scaled" / "causal.tum", truth).mode == "mono"
    assert load_inputs(runs / "unknown", truth).mode == "mono"


def test_points_and_models_are_in_metres(runs: Path) -> None:
    plain, scaled = (_ply_points(runs / f"{name}.ply") for name in ("plain", "scaled"))
    assert len(plain) > 100
    np.testing.assert_allclose(scaled, VALUE * plain, rtol=1e-5, atol=1e-5)
    plain, scaled = (_colmap_points(runs / f"{name}-colmap") for name in ("plain", "scaled"))
    assert len(plain) > 100
    np.testing.assert_allclose(scaled, VALUE * plain, rtol=1e-5, atol=1e-5)


def _ply_points(path: Path) -> np.ndarray:
    header, _, body = path.read_bytes().partition(b"end_header\n")
    assert b"property float x\nproperty float y\nproperty float z" in header
    count = int(header.split(b"element vertex ")[1].split()[0])
    size = len(body) // count
    raw = np.frombuffer(body, np.uint8).reshape(count, size)[:, :12]
    return np.ascontiguousarray(raw).view("<f4").astype(float)


def _colmap_points(folder: Path) -> np.ndarray:
    text = (folder / "sparse" / "0" / "points3D.txt").read_text(encoding="utf-8")
    rows = [line.split()[1:4] for line in text.splitlines() if line and line[0] != "#"]
    return np.array(rows, dtype=float)


def geodetic_csv(truth: Path, path: Path, *, offset_s: float = 0.0) -> Path:
    """True positions as those of GPS, with 5 mm of noise."""
    known = read_tum(truth)
    noise = np.random.default_rng(0).normal(0.0, 0.005, (len(known), 3))
    geodetic = geodetic_from_enu(known.positions[:, [0, 2, 1]] * (1, 1, -1) + noise, ORIGIN)
    rows = zip(known.stamps_ns.tolist(), geodetic.tolist(), strict=True)
    lines = [f"{s + round(1e9 * offset_s)},{a:.10f},{b:.10f},{c:.5f}" for s, (a, b, c) in rows]
    path.write_text("\n".join(["stamp_ns,lat,lon,alt", *lines]) + "\n")
    return path


def test_positions_give_the_scale_and_the_place(synthetic_stereo: Path, tmp_path: Path) -> None:
    truth = synthetic_stereo / "groundtruth.tum"
    table = geodetic_csv(truth, tmp_path / "gps.csv")
    scale = ScaleOptions(str(table), georeference=True)
    run(synthetic_stereo, tmp_path / "mono", config=FAST, mode="mono", scale=scale)
    moving = ScaleOptions(gps=str(table), georeference=True)
    run(synthetic_stereo, tmp_path / "stereo", config=FAST, scale=moving)
    for name in ("mono", "stereo"):
        result = evaluate(read_tum(tmp_path / name / "trajectory.tum"), read_tum(truth))
        assert abs(result.alignment.scale_error_percent or 0.0) < 3.0
        geojson = json.loads((tmp_path / name / "path.geojson").read_text())
        points = np.array(geojson["features"][0]["geometry"]["coordinates"])
        enu = enu_from_geodetic(points[:, [1, 0, 2]], ORIGIN)
        path = read_tum(tmp_path / name / "trajectory.tum")
        rows = np.searchsorted(read_tum(truth).stamps_ns, path.stamps_ns)
        expected = (read_tum(truth).positions[:, [0, 2, 1]] * (1, 1, -1))[rows]
        assert np.linalg.norm(enu - expected, axis=1).max() < 0.03
        assert (tmp_path / name / "path.kml").is_file()
        placed = read_tum(tmp_path / name / "path_enu.tum")
        longitude, latitude, height = geojson["enu_origin"]
        back = geodetic_from_enu(placed.positions, np.array([latitude, longitude, height]))
        np.testing.assert_allclose(back[:, [1, 0]], points[:, :2], atol=2e-9)
        np.testing.assert_allclose(back[:, 2], points[:, 2], atol=2e-3)
        true = read_tum(truth).world_from_cam[rows][:, :3, :3]
        to_enu = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        assert np.abs(placed.world_from_cam[:, :3, :3] - to_enu @ true).max() < 0.05
    assert summary(tmp_path / "mono")["scales"][0]["source"] == "gps"
    assert summary(tmp_path / "stereo")["scales"] == []
    given = np.loadtxt(tmp_path / "stereo" / "given_positions.csv", delimiter=",", skiprows=1)
    path = read_tum(tmp_path / "stereo" / "trajectory.tum")
    near = np.searchsorted(path.stamps_ns, given[:, 0])
    assert (near < len(path)).sum() >= len(path) - 1 and not given[:, 1].any()
    off = given[near < len(path), 2:5] - path.positions[near[near < len(path)]]
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.02  # their noise is 0.005 m on each axis
    np.testing.assert_allclose(
        enu_from_geodetic(given[:, 5:], ORIGIN)[5] - enu_from_geodetic(given[:, 5:], ORIGIN)[0],
        expected[5] - expected[0],
        atol=0.05,
    )
    run(synthetic_stereo, tmp_path / "stereo", config=FAST, mode="mono", end=8)
    for name in ("path.kml", "given_positions.csv"):
        assert not (tmp_path / "stereo" / name).exists()  # of the earlier run


@pytest.mark.parametrize("name", ["kitti07_mono_000-099", "kitti_raw_stereo_000-099"])
def test_a_drive_has_its_length_by_positions_with_2_m_of_noise(
    shared_data: Path, tmp_path: Path, name: str
) -> None:
    truth = vo.open(shared_data / name, mode="mono").ground_truth
    assert truth is not None
    noisy = truth.positions + np.random.default_rng(1).normal(0.0, 2.0, truth.positions.shape)
    rows = zip(truth.stamps_ns.tolist(), noisy.tolist(), strict=True)
    lines = [f"{stamp},{x:.4f},{y:.4f},{z:.4f}" for stamp, (x, y, z) in rows]
    table = tmp_path / "gps.csv"
    table.write_text("\n".join(["stamp_ns,x,y,z", *lines]) + "\n")
    output = tmp_path / "out"
    run(shared_data / name, output, config=FAST, mode="mono", scale=ScaleOptions(str(table)))
    (scale,) = summary(output)["scales"]
    assert scale["sigma"] < 0.04 * scale["value"]
    path = read_tum(output / "trajectory.tum")
    during = (path.stamps_ns >= truth.stamps_ns[0]) & (path.stamps_ns <= truth.stamps_ns[-1])
    stamps_ns = path.stamps_ns[during]
    axes = [np.interp(stamps_ns, truth.stamps_ns, axis) for axis in truth.positions.T]
    assert len(stamps_ns) > 90
    known = _length(np.column_stack(axes))
    assert _length(path.positions[during]) == pytest.approx(known, rel=0.03)


def _with_positions(source: Path, output: Path, noise_m: float) -> None:
    """Run with the true positions and noise, and as `without` next to it with none."""
    truth = vo.open(source).ground_truth
    assert truth is not None
    noise = np.random.default_rng(1).normal(0.0, noise_m, truth.positions.shape)
    rows = zip(truth.stamps_ns.tolist(), (truth.positions + noise).tolist(), strict=True)
    lines = [f"{stamp},{x:.4f},{y:.4f},{z:.4f}" for stamp, (x, y, z) in rows]
    table = output.with_suffix(".csv")
    table.write_text("\n".join(["stamp_ns,x,y,z", *lines]) + "\n")
    constant = ["camera.focal=constant"]  # else both runs search another focal length: 15 s
    vo.run(source, output, overrides=constant, gps=str(table))
    vo.run(source, output.with_name("without"), overrides=constant)


def test_exact_positions_move_a_drive(shared_data: Path, tmp_path: Path) -> None:
    """KITTI 05, one camera, 0.25 m off."""
    source = shared_data / "kitti05_mono_000-149"
    _with_positions(source, tmp_path / "exact", 0.02)
    names = ("exact", "without")
    causal = [(tmp_path / name / "causal.tum").read_bytes() for name in names]
    assert causal[0] == causal[1]
    exact, without = (vo.evaluate(tmp_path / name, source).ate.translation.rmse for name in names)
    assert exact < 0.3 * without
    (use,) = summary(tmp_path / "exact")["positions"]
    assert use["moved_m"] > 0.1 and use["used"] > 140 and use["sigma_m"] < 0.1
    first = [read_tum(tmp_path / name / "trajectory.tum").world_from_cam[0] for name in names]
    np.testing.assert_array_equal(*first)


def test_positions_that_are_worse_than_two_cameras_leave_every_byte(
    shared_data: Path, tmp_path: Path
) -> None:
    """KITTI raw, 74 m: positions of 2 m of noise cannot see errors of 0.2 m."""
    _with_positions(shared_data / "kitti_raw_stereo_000-099", tmp_path / "rough", 2.0)
    for table in ("trajectory.tum", "poses.csv", "covariance.csv", "causal.tum"):
        rough, without = ((tmp_path / name / table).read_bytes() for name in ("rough", "without"))
        assert rough == without
    (use,) = summary(tmp_path / "rough")["positions"]
    assert use["moved_m"] == 0.0 and 1.0 < use["white_m"] < 3.0


def _length(positions: Floats) -> float:
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scale-from", "none.csv"], "none.csv does not exist"),
        (["--scale-from", "late.csv"], "no position during the recording"),
        (["--gps", "late.csv"], "no position during the recording"),
        (["--gps", "late.csv", "--scale-from", "late.csv"], "leave --scale-from out"),
        (["--georeference"], "--georeference needs positions: give them by --gps"),
        (["--scale-offset", "3"], "--scale-offset is for the positions of --gps"),
        (["--scale-from", "metres.csv", "--georeference"], "needs latitudes and longitudes"),
        (["--lever-arm", "0.5", "-1", "-1.5"], "--lever-arm is for the positions of --gps"),
        (
            ["--scale-from", "metres.csv", "--lever-arm", "500", "-1000", "-1500"],
            "--lever-arm is 500 -1000 -1500; give metres",
        ),
    ],
)
def test_what_cannot_be_measured_is_told_before_the_run(
    synthetic_stereo: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    geodetic_csv(synthetic_stereo / "groundtruth.tum", tmp_path / "late.csv", offset_s=100.0)
    (tmp_path / "metres.csv").write_text("time,x,y\n1,2,3\n2,3,4\n")
    arguments = ["run", str(synthetic_stereo), "-o", "out", "--mode", "mono", *options]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())
    assert not (tmp_path / "out" / "trajectory.tum").exists()
