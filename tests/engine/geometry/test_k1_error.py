from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.types import Camera, Rig
from vo.engine.geometry.k1_error import edge_shift_px, residual_per_k1


def _rig(*distortion: float) -> RectifiedRig:
    model = "radtan" if distortion else "none"
    lens = Camera(640, 400, 420.0, 420.0, 319.5, 199.5, model, distortion)
    return rectified_rig(Rig(lens))


def test_an_error_moves_the_corners_by_the_cube_of_their_radius() -> None:
    radius = np.hypot(319.5, 199.5) / 420.0
    assert edge_shift_px(_rig(), 0.01) == pytest.approx(0.01 * 420.0 * radius**3, rel=1e-6)


def test_a_lens_that_does_not_reach_the_corners_has_a_finite_shift() -> None:
    assert 0.0 < edge_shift_px(_rig(-0.4, 0.0, 0.0, 0.0), 0.01) < 10.0


def test_without_distortion_the_residual_is_that_of_the_image() -> None:
    assert residual_per_k1(_rig()) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(
    "distortion", [(-0.28, 0.07, 0.0, 0.0), (0.26, -0.95, -0.005, 0.0026, 1.16)]
)
def test_undistortion_scales_the_residual(
    distortion: tuple[float, ...],
) -> None:
    rig = _rig(*distortion)
    xy = np.random.default_rng(0).uniform((0.0, 0.0), (639.0, 399.0), (500, 2))
    ideal, wrong = rig.undistort(xy), rig.with_k1_error(0.002).undistort(xy)
    ray = (ideal - (319.5, 199.5)) / 420.0
    predicted = ideal - 0.002 * residual_per_k1(rig) * 420.0 * ray * np.sum(
        ray**2, axis=1, keepdims=True
    )
    remaining, before = (np.linalg.norm(at - wrong, axis=1) for at in (predicted, ideal))
    assert np.sqrt(np.mean(remaining**2)) < 0.35 * np.sqrt(np.mean(before**2))
