"""A run of one camera that only turns."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from data_synth.writers import euroc
from vo.cli.app import app
from vo.recordings.formats.trajectory import read_tum


def test_a_camera_that_only_turns_has_orientations_and_no_path(tmp_path: Path) -> None:
    settings = ["motion=rotate", "seconds=6", "fps=10", "scale=0.47", "mono=true", "seed=3"]
    plan = make_plan(load_recipe(None, settings))
    walk, output = tmp_path / "turn", tmp_path / "out"
    with ThreadPoolExecutor() as pool:
        shots = render_frames(plan, pool, range(len(plan.recording.stamps_ns[0])))
        euroc.write(walk, plan.recording, shots, "png")
    result = CliRunner().invoke(app, ["run", str(walk), "-o", str(output)])
    assert result.exit_code == 3  # no path
    summary = json.loads((output / "summary.json").read_text("utf-8"))
    assert summary["verdict"] == "no path" and not summary["trusted"]
    assert summary["tracked"] == 0 and summary["inertial_orientations"] == 60
    assert summary["keyframes"] == 0
    assert any("without a position" in warning for warning in summary["warnings"])
    rows = np.loadtxt(output / "poses.csv", delimiter=",", skiprows=1)
    assert rows[:, 0].tolist() == list(range(60)) and (rows[:, 4] == 3).all()
    assert (rows[:, 5:8] == 0.0).all() and (output / "causal.tum").read_text() == ""
    found, truth = read_tum(output / "trajectory.tum"), read_tum(walk / "groundtruth.tum")
    at = np.searchsorted(truth.stamps_ns, found.stamps_ns - 1000)
    here, true = found.world_from_cam[:, :3, :3], truth.world_from_cam[at, :3, :3]
    turned = (true[0] @ here[0].T) @ here
    cosine = 0.5 * (np.einsum("nij,nij->n", turned, true) - 1.0)
    assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < 1.0
    # The camera turned further than any of its images can see.
    assert np.degrees(np.arccos(np.clip((true[0].T @ true)[:, 2, 2], -1.0, 1.0))).max() > 90.0
