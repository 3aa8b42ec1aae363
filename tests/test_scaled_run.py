"""A mono run with a known scale: what is in metres, and what stays in units of the map."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vo.config import load_config
from vo.evaluation.inputs import load_inputs
from vo.formats.trajectory import read_tum
from vo.metric_scale import MetricScale, ScaleFindings
from vo.recording.exports import Exports
from vo.run_recording import run
from vo.types import Estimate, PlacedFrames, Snapshot

FAST = load_config("fast")
VALUE, SIGMA = 2.5, 0.05


class Known:
    """A source that knows the scale of every world, or of none."""

    def __init__(self, *scales: MetricScale, note: str = "") -> None:
        self._findings = ScaleFindings(scales, (note,) if note else ())
        self.frames: list[int] = []

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        self.frames.append(estimate.frame_index)
        assert snapshot().view.image0.ndim == 2

    def measure(self, path: PlacedFrames) -> ScaleFindings:
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
