"""A camera is moved until a slanted plane looks as it did."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from feature_scenes import Waves, as_image, pixels

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import se3_exp, transform_points
from vo.base.types import Bytes, Floats
from vo.engine.frontend.camera_alignment import align_sparse, half_size_pyramid
from vo.engine.frontend.image_gradients import mean_product
from vo.engine.frontend.optical_flow import follow

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


def texture() -> Bytes:
    noise = np.random.default_rng(0).integers(0, 256, (240, 320)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def grid() -> Floats:
    u, v = np.meshgrid(np.arange(40.0, 290.0, 10.0), np.arange(40.0, 210.0, 10.0))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def moved(image: Bytes, affine: Floats) -> Bytes:
    size = image.shape[1], image.shape[0]
    border = cv2.BORDER_REFLECT_101
    return cv2.warpAffine(image, affine, size, flags=cv2.INTER_CUBIC, borderMode=border)


def test_points_are_found_to_a_fraction_of_a_pixel() -> None:
    image, xy = texture(), grid()
    affine = np.array([[1.02, 0.01, 6.3], [-0.01, 1.01, -4.6]])
    flow = follow(image, moved(image, affine), xy, xy)
    expected = xy @ affine[:, :2].T + affine[:, 2]
    inside = ((expected > 45) & (expected < [275, 195])).all(axis=1)
    assert flow.found[inside].mean() > 0.97
    errors = np.linalg.norm(flow.xy - expected, axis=1)[inside & flow.found]
    assert np.median(errors) < 0.08
    assert errors.max() < 0.3


def test_what_is_hidden_or_has_left_is_not_found() -> None:
    image, xy = texture(), grid()
    covered = image.copy()
    other = texture()[::-1].copy()
    covered[:, 160:] = other[:, 160:]
    flow = follow(image, covered, xy, xy)
    left, right = xy[:, 0] < 140, xy[:, 0] > 180
    assert flow.found[left].all()
    assert flow.found[right].mean() < 0.2
    flat = np.full_like(image, 90)
    assert not follow(image, flat, xy, xy).found.any()
    assert not follow(image, image, xy, xy + 1000.0).found.any()
    assert len(follow(image, image, xy[:0], xy[:0]).found) == 0


@pytest.mark.parametrize("shape", [(4, 4), (5, 31), (40, 7), (120, 161)])
def test_means_are_those_of_a_box_filter_with_mirrored_borders(shape: tuple[int, int]) -> None:
    values = np.random.default_rng(0).normal(0.0, 10.0, (4, *shape)).astype(np.float32)
    u, v, other_u, other_v = values
    expected = cv2.boxFilter(u * other_u + v * other_v, -1, (7, 7))
    found = mean_product(u, v, other_u, other_v)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 2), (3, 3)])
def test_means_of_images_smaller_than_the_window_are_finite(shape: tuple[int, int]) -> None:
    u = np.full(shape, 2.0, np.float32)
    assert np.isfinite(mean_product(u, u, u, u)).all()
