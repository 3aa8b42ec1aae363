"""The ground below a camera: found where it is, refused where it is not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import vo
from vo.base.config import load_config
from vo.base.errors import ConfigError
from vo.base.geometry.transforms import so3_exp
from vo.base.types import Floats
from vo.runs.run_recording import run
from vo.runs.scaling.ground import find_ground
from vo.runs.scaling.scale_sources import ScaleOptions

FORWARD = np.array([0.0, 0.0, 1.0])


def walls(rng: np.random.Generator, count: int) -> Floats:
    """Points on houses on both sides of a street, above the ground at 1.5."""
    side = rng.choice([-6.0, 6.0], count)
    return np.column_stack([side, rng.uniform(-4.0, 1.2, count), rng.uniform(3.0, 30.0, count)])


def road(rng: np.random.Generator, count: int, noise: float) -> Floats:
    points = np.column_stack(
        [rng.uniform(-4, 4, count), np.full(count, 1.5), rng.uniform(3, 14, count)]
    )
    return np.asarray(points + rng.normal(0.0, noise, points.shape))


@pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 1e-9), (0.03, 0.02)])
def test_the_road_of_a_tilted_camera(noise: float, tolerance: float) -> None:
    """10 % of the points are on the road; the camera looks down by 5 degrees."""
    rng = np.random.default_rng(1)
    tilt = so3_exp(np.array([-0.087, 0.0, 0.02]))
    points = np.concatenate([walls(rng, 400), road(rng, 45, noise)])
    if not noise:
        points[:400, 1] -= 1.0  # none near the plane
    ground = find_ground(points @ tilt.T, tilt @ FORWARD, np.random.default_rng(0))
    assert ground is not None
    assert ground.height == pytest.approx(1.5, rel=tolerance)
    assert np.degrees(np.arccos(min(ground.normal @ tilt[:, 1], 1.0))) < 1.5
    scaled = find_ground(3.0 * points @ tilt.T, tilt @ FORWARD, np.random.default_rng(0))
    assert scaled is not None and scaled.height == pytest.approx(3.0 * ground.height, rel=1e-6)


def test_no_ground_where_there_is_none() -> None:
    """Houses alone, a cloud, and a wall in front: 60 times none."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        wall = np.column_stack(
            [rng.uniform(-5, 5, 300), rng.uniform(-4, 4, 300), rng.normal(8.0, 0.05, 300)]
        )
        cloud = rng.uniform((-6, -5, 2), (6, 5, 25), (300, 3))
        for points in (walls(rng, 300), wall, cloud):
            assert find_ground(points, FORWARD, np.random.default_rng(0)) is None


def test_a_ramp_across_the_motion_is_not_the_ground() -> None:
    rng = np.random.default_rng(2)
    points = road(rng, 100, 0.01)
    steep = np.array([0.0, np.sin(0.3), np.cos(0.3)])
    assert find_ground(points, steep, np.random.default_rng(0)) is None
    assert find_ground(points, FORWARD, np.random.default_rng(0)) is not None


def test_a_real_street(shared_data: Path, tmp_path: Path) -> None:
    """KITTI's cameras are 1.65 m above the ground."""
    recording = shared_data / "kitti07_mono_000-099"
    run(
        recording,
        tmp_path,
        config=load_config("fast"),
        end=60,
        scale=ScaleOptions(height_m=1.65),
    )
    (scale,) = json.loads((tmp_path / "summary.json").read_text())["scales"]
    assert scale["source"] == "camera height"
    assert 0.05 <= scale["sigma"] / scale["value"] < 0.08
    error = vo.evaluate(tmp_path, recording).alignment.scale_error_percent
    assert error is not None and abs(error) < 2.0 * 100 * scale["sigma"] / scale["value"]


def test_heights_that_cannot_be(synthetic_stereo: Path, tmp_path: Path) -> None:
    for height_m in (0.0, -1.0, 1650.0, float("nan")):
        with pytest.raises(ConfigError, match="give metres above the ground"):
            run(
                synthetic_stereo,
                tmp_path,
                config=load_config("fast"),
                mode="mono",
                scale=ScaleOptions(height_m=height_m),
            )
    with pytest.raises(ConfigError, match="`height_m` is for one camera"):
        run(
            synthetic_stereo,
            tmp_path,
            config=load_config("fast"),
            scale=ScaleOptions(height_m=1.65),
        )
