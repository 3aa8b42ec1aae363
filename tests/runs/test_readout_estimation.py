"""Readout times by the images: of rows that are exposed one after the other, exactly rendered."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import yaml

import vo
from vo.base.config import SmoothingConfig, load_config
from vo.base.errors import ConfigError
from vo.base.geometry.transforms import inverse
from vo.base.types import Camera, Estimate, Floats, Rig, State
from vo.engine.backend.lens_adjustment import WITH_CENTRE, KeyframeViews, Lens
from vo.engine.geometry import so3
from vo.recordings.sources.source import FrameStream
from vo.runs.readout import checked_readout
from vo.runs.readout_estimation import ReadoutFit, velocities
from vo.runs.run_options import RunOptions

MIDDLE = np.array([159.5, 119.5])
LENS = Lens(230.0, *MIDDLE.tolist(), -0.1, 0.012)
INTERVAL_S = 0.05


def poses(seconds: Floats) -> Floats:
    """Of a camera that is shaken while it moves."""
    waves = [
        0.2 * np.sin(2.5 * seconds),
        0.25 * np.cos(2.1 * seconds),
        0.15 * np.sin(3.1 * seconds),
    ]
    found = np.tile(np.eye(4), (len(seconds), 1, 1))
    found[:, :3, :3] = so3.exp(np.column_stack(waves))
    found[:, :3, 3] = np.column_stack(
        [0.5 * seconds, 0.3 * np.sin(1.7 * seconds), 0.2 * np.sin(seconds)]
    )
    return found


def pose(seconds: float) -> Floats:
    return np.asarray(poses(np.array([seconds]))[0])


def projected(points: Floats, world_from_cam: Floats) -> Floats:
    """Pixels of points, each seen from its own pose, or all from one."""
    rotations, places = world_from_cam[..., :3, :3], world_from_cam[..., :3, 3]
    seen = np.einsum("...i,...ij->...j", points - places, rotations)
    ideal = seen[:, :2] / seen[:, 2:]
    square = (ideal**2).sum(axis=1, keepdims=True)
    return np.asarray(MIDDLE + LENS.focal * ideal * (1 + LENS.k1 * square + LENS.k2 * square**2))


def recorded(readout_s: float, noise_px: float) -> ReadoutFit:
    """Thirty keyframes, each pixel seen from the pose at the time of its row."""
    rng = np.random.default_rng(3)
    points = np.column_stack(
        [rng.uniform(-4.0, 18.0, 900), rng.uniform(-4.0, 4.0, 900), rng.uniform(3.0, 9.0, 900)]
    )
    keyframe, point, xy, path = [], [], [], []
    for frame in range(180):
        each = pose(INTERVAL_S * frame)
        stamp_ns = 50_000_000 * frame
        path.append(Estimate(frame, stamp_ns, State.TRACKING, None, 0, each, False, 0, 0, 0, ()))
    for row in range(30):
        seconds = INTERVAL_S * 6 * row
        pixels = projected(points, pose(seconds))
        for _ in range(4):
            late = readout_s * (pixels[:, 1] / (2.0 * MIDDLE[1]) - 0.5)
            pixels = projected(points, poses(seconds + late))
        to_camera = inverse(pose(seconds))
        in_front = points @ to_camera[2, :3] + to_camera[2, 3] > 1
        in_view = ((pixels > 0) & (pixels < 2.0 * MIDDLE)).all(axis=1)
        seen = np.flatnonzero(in_front & in_view)
        keyframe += [row] * len(seen)
        point += seen.tolist()
        xy += (pixels[seen] + noise_px * rng.standard_normal((len(seen), 2))).tolist()
    rows = [6 * row for row in range(30)]
    at = poses(INTERVAL_S * np.array(rows))
    views = KeyframeViews(MIDDLE, at, points, np.array(keyframe), np.array(point), np.array(xy))
    views = views.part(0, 30)
    return ReadoutFit(views, velocities(path, rows), INTERVAL_S, SmoothingConfig(), WITH_CENTRE)


def test_a_readout_time_is_found_from_the_keyframes() -> None:
    found = recorded(0.02, 0.15).readout(LENS)
    assert found.seconds == pytest.approx(0.02, abs=0.001)
    assert 0.0 < found.sigma_s < 0.001


def test_a_global_shutter_is_not_taken_for_a_rolling_one() -> None:
    assert recorded(0.0, 0.15).readout(LENS).seconds == 0.0


def test_auto_corrects_the_rows_of_a_recording(tmp_path: Path) -> None:
    camera = tmp_path / "camera.yaml"
    camera.write_text(
        "cam0: {resolution: [240, 180], intrinsics: [172.0, 172.0, 119.5, 89.5], "
        "distortion_model: radtan, distortion: [-0.15, 0.03, 0.0, 0.0]}\n"
    )
    recording = tmp_path / "recording"
    vo.synth(
        recording,
        world="room",
        motion="handheld",
        camera=camera,
        mono=True,
        seconds=7.0,
        seed=4,
        effects="noise=1,rolling_shutter=1",
        overrides=["fps=20"],
    )
    errors = {}
    for readout in ("auto", 0.0):
        output = tmp_path / f"{readout}"
        vo.run(recording, output, loops=False, imu=False, overrides=[f"camera.readout_s={readout}"])
        errors[readout] = vo.evaluate(output, recording, align="sim3").ate.translation.rmse
    settings = yaml.safe_load((tmp_path / "auto" / "config.yaml").read_text())
    assert settings["camera"]["readout_s"] == pytest.approx(0.02, abs=0.003)
    assert errors["auto"] < 0.85 * errors[0.0]
    warnings = json.loads((tmp_path / "auto" / "summary.json").read_text())["warnings"]
    assert any("rows are read within" in str(each) for each in warnings)


def test_auto_needs_a_recording() -> None:
    config = load_config("default", ["camera.readout_s=auto"])
    stream = cast(FrameStream, SimpleNamespace(rig=Rig(Camera(64, 48, 50.0, 50.0, 31.5, 23.5))))
    with pytest.raises(ConfigError, match=r"`camera\.readout_s=auto` needs a recording"):
        checked_readout(stream, config, RunOptions())
