"""A camera is moved until a slanted plane looks as it did."""

from __future__ import annotations

import numpy as np
import pytest
from feature_scenes import Waves, as_image, pixels

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import se3_exp, transform_points
from vo.base.types import Bytes, Floats
from vo.engine.frontend.camera_alignment import align_sparse, half_size_pyramid

F, CX, CY, HEIGHT, WIDTH = 300.0, 159.5, 119.5, 240, 320
INTRINSICS = Intrinsics(F, F, CX, CY)
MATRIX = np.array([[F, 0.0, CX], [0.0, F, CY], [0.0, 0.0, 1.0]])
NORMAL, DISTANCE = np.array([-0.3, 0.2, 1.0]), 5.0  # of the plane: normal . p = distance
TEXTURE = Waves(seed=3, shortest_px=8.0, longest_px=120.0)
MOTION = se3_exp(np.array([0.02, -0.03, 0.04, 0.1, -0.05, 0.2]))


def points_at(xy: Floats) -> Floats:
    rays = (xy - (CX, CY)) / F
    rays = np.column_stack([rays, np.ones(len(xy))])
    return np.asarray(rays * (DISTANCE / (rays @ NORMAL))[:, None])


def seen_after(target_from_reference: Floats) -> Floats:
    """Grey levels of the plane, whose texture is known in pixels of the reference."""
    rotation, translation = target_from_reference[:3, :3], target_from_reference[:3, 3]
    homography = MATRIX @ (rotation + np.outer(translation, NORMAL) / DISTANCE)
    homography = homography @ np.linalg.inv(MATRIX)
    at = pixels(HEIGHT, WIDTH).reshape(-1, 2)
    back = np.column_stack([at, np.ones(len(at))]) @ np.linalg.inv(homography).T
    return TEXTURE.at((back[:, :2] / back[:, 2:]).reshape(HEIGHT, WIDTH, 2))


def aligned(target: Bytes, start: Floats, xy: Floats) -> tuple[float, Floats]:
    """Mean error of where points are seen, in pixels, and the scores."""
    points = points_at(xy)
    found = align_sparse(
        *(
            half_size_pyramid(as_image(seen_after(np.eye(4)))),
            xy,
            half_size_pyramid(target),
            points,
        ),
        *(start, np.tile(np.eye(2, 3), (len(xy), 1, 1)), INTRINSICS),
    )
    return error_px(found.target_from_reference, points), found.score


def error_px(motion: Floats, points: Floats) -> float:
    true, found = (transform_points(t, points) for t in (MOTION, motion))
    off = F * (true[:, :2] / true[:, 2:] - found[:, :2] / found[:, 2:])
    return float(np.linalg.norm(off, axis=1).mean())


@pytest.fixture(scope="module")
def xy() -> Floats:
    return np.random.default_rng(0).uniform((40, 40), (WIDTH - 40, HEIGHT - 40), (150, 2))


def test_motion_of_many_pixels_is_found_to_a_tenth(xy: Floats) -> None:
    assert error_px(np.eye(4), points_at(xy)) > 10.0
    error, score = aligned(as_image(seen_after(MOTION)), np.eye(4), xy)
    assert error < 0.1
    assert np.median(score) > 0.98


def test_exposure_makes_no_difference(xy: Floats) -> None:
    darker = as_image(seen_after(MOTION) * 0.6 + 20.0)
    assert aligned(darker, np.eye(4), xy)[0] < 0.1


def test_what_was_covered_counts_little(xy: Floats) -> None:
    covered = seen_after(MOTION)
    other = Waves(seed=9, shortest_px=8.0, longest_px=120.0).at(pixels(HEIGHT, WIDTH))
    covered[:, WIDTH * 2 // 3 :] = other[:, WIDTH * 2 // 3 :]
    error, score = aligned(as_image(covered), np.eye(4), xy)
    assert error < 0.5
    assert np.mean(score < 0.5) > 0.15


def test_lens_is_undone_on_the_way_to_the_image(xy: Floats) -> None:
    """The target is stored upside down, and the affine maps say so."""
    points = points_at(xy)
    turned = np.tile(np.array([[-1.0, 0.0, WIDTH - 1], [0.0, -1.0, HEIGHT - 1]]), (len(xy), 1, 1))
    reference = as_image(seen_after(np.eye(4)))[::-1, ::-1]
    found = align_sparse(
        half_size_pyramid(np.ascontiguousarray(reference)),
        (WIDTH - 1, HEIGHT - 1) - xy,
        half_size_pyramid(np.ascontiguousarray(as_image(seen_after(MOTION))[::-1, ::-1])),
        *(points, np.eye(4), turned, INTRINSICS),
    )
    assert error_px(found.target_from_reference, points) < 0.1


def test_images_without_texture_move_nothing(xy: Floats) -> None:
    grey = half_size_pyramid(np.full((HEIGHT, WIDTH), 90, np.uint8))
    maps = np.tile(np.eye(2, 3), (len(xy), 1, 1))
    found = align_sparse(grey, xy, grey, points_at(xy), MOTION, maps, INTRINSICS)
    assert (found.score == -1.0).all()
    np.testing.assert_allclose(found.target_from_reference, MOTION, atol=1e-12)


def test_points_behind_the_camera_and_outside_are_left_out(xy: Floats) -> None:
    points, far = points_at(xy), xy.copy()
    points[:40, 2] *= -1.0
    far[40:60] += 1000.0
    images = half_size_pyramid(as_image(seen_after(MOTION)))
    found = align_sparse(
        *(half_size_pyramid(as_image(seen_after(np.eye(4)))), far, images, points, np.eye(4)),
        *(np.tile(np.eye(2, 3), (len(xy), 1, 1)), INTRINSICS),
    )
    assert (found.score[:60] == -1.0).all()
    assert error_px(found.target_from_reference, points[60:]) < 0.1


def test_half_size_pyramid_keep_where_things_are() -> None:
    """Pixel p of the full size lies at (p + 1/2) / 2 - 1/2 of the half."""
    ramp = np.tile(np.arange(200, dtype=np.uint8), (151, 1))
    half, quarter = half_size_pyramid(ramp)
    assert half.shape == (75, 100) and quarter.shape == (37, 50)
    x = np.arange(100)
    np.testing.assert_allclose(half[0], (x + 0.5) * 2 - 0.5, atol=0.5)
