"""Homographies of patches on planes."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import inverse, make_transform, so3_exp, transform_points
from vo.base.types import Floats
from vo.engine.geometry.homographies import homographies
from vo.engine.geometry.patch_prediction import predict_patches

FOCAL, CENTRE = 200.0, np.array([160.0, 120.0])


def _pixels(points: Floats) -> Floats:
    return points[:, :2] / points[:, 2:] * FOCAL + CENTRE


def test_pixels_of_a_plane_are_mapped_to_the_reference() -> None:
    reference = make_transform(so3_exp(np.array([0.05, 0.1, 0.0])), np.zeros(3))
    target = make_transform(so3_exp(np.array([0.0, -0.5, 0.02])), np.array([0.3, 0.1, 0.8]))
    intrinsics = Intrinsics(FOCAL, FOCAL, *CENTRE)
    point, normal = np.array([[0.4, 1.2, 4.0]]), np.array([[0.1, -1.0, 0.2]])
    first, poses = np.zeros(1, np.int64), np.stack([reference, target])
    seen = predict_patches(point, normal, first, first, first + 1, poses, intrinsics)
    depth_by_target = (inverse(reference) @ target)[2:3]
    near = 1.0 / transform_points(inverse(target), point)[:, 2]
    warp = homographies(
        seen.reference_from_target, seen.xy, depth_by_target, near, seen.slope, intrinsics
    )[0]
    offsets = 6.0 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1]])
    pixels = np.concatenate([seen.xy + offsets, np.zeros((6, 1))], axis=1)
    rays = np.concatenate([(pixels[:, :2] - CENTRE) / FOCAL, np.ones((6, 1))], axis=1)
    rays = rays @ target[:3, :3].T
    far = ((point - target[:3, 3]) @ normal[0]) / (rays @ normal[0])
    on_plane = target[:3, 3] + far[:, None] * rays
    at, *_ = _pixels(transform_points(inverse(reference), point))
    truth = _pixels(transform_points(inverse(reference), on_plane)) - at
    affine = offsets @ warp[:2].T
    # The affine part itself is a difference over a pixel.
    np.testing.assert_allclose(affine / (1.0 + offsets @ warp[2])[:, None], truth, atol=0.05)
    assert np.abs(affine - truth).max() > 0.2
