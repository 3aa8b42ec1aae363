from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vo.base.geometry import cameras
from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.geometry.transforms import inverse, make_transform, so3_exp, transform_points
from vo.base.types import Bytes, Camera, DistortionModel, Floats, Rig

WIDTH, HEIGHT = 640, 400
PLAIN = Camera(WIDTH, HEIGHT, 420.0, 415.0, 318.0, 203.0)
RADTAN = (-0.28, 0.08, 0.0004, -0.0003)
EQUIDISTANT = (-0.012, 0.006, -0.004, 0.001)
CAM1_FROM_CAM0 = make_transform(so3_exp(np.array([0.01, -0.015, 0.02])), [-0.11, 0.003, -0.004])


def _pair(
    model: DistortionModel, coefficients: tuple[float, ...], cam1_from_cam0: Floats = CAM1_FROM_CAM0
) -> Rig:
    cam0 = replace(PLAIN, distortion_model=model, distortion=coefficients)
    cam1 = replace(cam0, fx=424.0, fy=418.0, cx=324.0, cy=197.0)
    return Rig(cam0, cam1, cam1_from_cam0)


def _ideal_pair(x: float) -> Rig:
    return Rig(PLAIN, PLAIN, make_transform(np.eye(3), np.array([x, 0.0, 0.0])))


def _dots(pixels: Floats, size: float = 2.5) -> Bytes:
    """An image with a bright, round dot at each position."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    image = np.zeros((HEIGHT, WIDTH))
    for x, y in pixels:
        image += 230.0 * np.exp(-0.5 * ((u - x) ** 2 + (v - y) ** 2) / size**2)
    return np.asarray(np.clip(np.round(image), 0, 255), dtype=np.uint8)


def _centroid(image: Bytes, near: Floats, reach: int = 9) -> Floats:
    u, v = np.round(near).astype(int)
    part = image[v - reach : v + reach + 1, u - reach : u + reach + 1].astype(np.float64)
    rows, columns = np.mgrid[v - reach : v + reach + 1, u - reach : u + reach + 1]
    return np.array([np.sum(part * columns), np.sum(part * rows)]) / np.sum(part)


def _points(rectified: RectifiedRig, depth: float) -> tuple[Floats, Floats]:
    """Points at a depth in the rectified camera's frame, and their undistorted pixels."""
    u, v = np.meshgrid(np.arange(140.0, WIDTH - 60, 60), np.arange(50.0, HEIGHT - 40, 60))
    xy = np.column_stack([u.ravel(), v.ravel()]) + (0.3, -0.4)
    return rectified.back_project(xy, np.full(len(xy), depth)), xy


# Rectified pairs


def test_a_rectified_pair_is_not_changed() -> None:
    rectified = rectified_rig(_ideal_pair(-0.12))
    assert (rectified.fx, rectified.fy, rectified.cx, rectified.cy) == (420.0, 415.0, 318.0, 203.0)
    assert (rectified.width, rectified.height) == (WIDTH, HEIGHT)
    assert rectified.baseline_m == 0.12
    assert rectified.is_metric
    np.testing.assert_array_equal(rectified.cam0_from_rectified, np.eye(4))
    image = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    for side in (0, 1):
        np.testing.assert_array_equal(rectified.rectify(image, side), image)


# Unrectified pairs

PAIRS = [
    pytest.param("none", (), id="turned only"),
    pytest.param("radtan", RADTAN, id="radtan"),
    pytest.param("radtan", (*RADTAN, 0.01), id="radtan 5"),
    pytest.param("radtan", (0.4, 0.1, 1e-4, 2e-4, 0.01, 0.7, 0.2, 0.03), id="radtan 8"),
    pytest.param("equidistant", EQUIDISTANT, id="equidistant"),
    pytest.param("double_sphere", (-0.17, 0.59), id="double sphere"),
    pytest.param("extended_unified", (0.59, 1.13), id="extended unified"),
    pytest.param("omni", (0.3, -0.05, 0.01, 1e-4, -2e-4), id="omni"),
]


@pytest.mark.parametrize(("model", "coefficients"), PAIRS)
@pytest.mark.parametrize("depth", [1.5, 8.0])
def test_rectified_points_are_in_the_same_row_with_the_disparity_of_their_depth(
    model: DistortionModel, coefficients: tuple[float, ...], depth: float
) -> None:
    rig = _pair(model, coefficients)
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    rectified = rectified_rig(rig)
    points, xy = _points(rectified, depth)
    in_cam0 = transform_points(rectified.cam0_from_rectified, points)
    in_cam1 = transform_points(rig.cam1_from_cam0, in_cam0)
    left = rectified.rectify(_dots(cameras.project(rig.cam0, in_cam0)), 0)
    right = rectified.rectify(_dots(cameras.project(rig.cam1, in_cam1)), 1)
    expected = xy - (rectified.fx * rectified.baseline_m / depth, 0.0)
    assert left.shape == right.shape == (rectified.height, rectified.width)
    found_left = np.array([_centroid(left, at) for at in xy])
    found_right = np.array([_centroid(right, at) for at in expected])
    np.testing.assert_allclose(found_left, xy, atol=0.1)
    np.testing.assert_allclose(found_right, expected, atol=0.1)
    assert np.median(np.abs(found_left[:, 1] - found_right[:, 1])) < 0.03


@pytest.mark.parametrize(("model", "coefficients"), PAIRS)
def test_rectification_only_rotates_cam0(
    model: DistortionModel, coefficients: tuple[float, ...]
) -> None:
    rectified = rectified_rig(_pair(model, coefficients))
    cam0_from_rectified = rectified.cam0_from_rectified
    np.testing.assert_allclose(cam0_from_rectified[:3, 3], 0.0, atol=1e-12)
    assert rectified.baseline_m == pytest.approx(np.linalg.norm(CAM1_FROM_CAM0[:3, 3]), rel=1e-9)
    # The right camera lies on the rectified camera's x axis, at the baseline.
    centre = transform_points(inverse(cam0_from_rectified), inverse(CAM1_FROM_CAM0)[None, :3, 3])
    np.testing.assert_allclose(centre, [[rectified.baseline_m, 0.0, 0.0]], atol=1e-9)


@pytest.mark.parametrize(("model", "coefficients"), PAIRS)
def test_rectified_images_keep_a_useful_field_of_view(
    model: DistortionModel, coefficients: tuple[float, ...]
) -> None:
    rectified = rectified_rig(_pair(model, coefficients))
    white = np.full((HEIGHT, WIDTH), 255, np.uint8)
    for side in (0, 1):
        assert np.mean(rectified.rectify(white, side) == 255) > 0.85
    assert 0.7 < rectified.fx / PLAIN.fx < 1.4


def test_rectified_stereo_pixels_have_no_distortion() -> None:
    rectified = rectified_rig(_pair("radtan", RADTAN))
    xy = np.random.default_rng(0).uniform((0, 0), (WIDTH, HEIGHT), (50, 2))
    np.testing.assert_array_equal(rectified.undistort(xy), xy)
    np.testing.assert_array_equal(rectified.distort(xy), xy)


# A single camera

NARROW, WIDE = PAIRS[1:4], PAIRS[4:]


def test_a_single_camera_without_distortion_is_not_changed() -> None:
    rectified = rectified_rig(Rig(PLAIN))
    assert not rectified.is_metric and rectified.baseline_m == 0.0
    xy = np.random.default_rng(0).uniform((0, 0), (WIDTH, HEIGHT), (50, 2))
    np.testing.assert_array_equal(rectified.undistort(xy), xy)


@pytest.mark.parametrize(("model", "coefficients"), NARROW)
def test_mono_pixels_are_undistorted_and_distorted_again(
    model: DistortionModel, coefficients: tuple[float, ...]
) -> None:
    camera = replace(PLAIN, distortion_model=model, distortion=coefficients)
    rectified = rectified_rig(Rig(camera))
    xy = np.random.default_rng(0).uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (500, 2))
    ideal = rectified.undistort(xy)
    assert np.isfinite(ideal).all()
    assert np.linalg.norm(ideal - xy, axis=1).max() > 3.0
    np.testing.assert_allclose(rectified.distort(ideal), xy, atol=1e-6)


@pytest.mark.parametrize(("model", "coefficients"), NARROW)
def test_undistorted_pixels_are_those_of_a_pinhole(
    model: DistortionModel, coefficients: tuple[float, ...]
) -> None:
    camera = replace(PLAIN, distortion_model=model, distortion=coefficients)
    rectified = rectified_rig(Rig(camera))
    points = np.random.default_rng(0).uniform((-2, -1, 4), (2, 1, 9), (100, 3))
    ideal = rectified.undistort(cameras.project(camera, points))
    np.testing.assert_allclose(ideal, rectified.project(points), atol=1e-6)
    np.testing.assert_allclose(rectified.back_project(ideal, points[:, 2]), points, atol=1e-6)


@pytest.mark.parametrize(("model", "coefficients"), WIDE)
def test_a_single_wide_camera_is_rectified(
    model: DistortionModel, coefficients: tuple[float, ...]
) -> None:
    camera = replace(PLAIN, distortion_model=model, distortion=coefficients)
    rectified = rectified_rig(Rig(camera))
    assert not rectified.is_metric
    np.testing.assert_array_equal(rectified.cam0_from_rectified, np.eye(4))
    points, xy = _points(rectified, 2.0)
    image = rectified.rectify(_dots(cameras.project(camera, points)), 0)
    np.testing.assert_allclose([_centroid(image, at) for at in xy], xy, atol=0.1)
    np.testing.assert_array_equal(rectified.undistort(xy), xy)
    # What is on the axis keeps its size.
    steps = cameras.distort(camera, np.array([[0.0, 0.0], [0.01, 0.0]]))
    assert rectified.fx == pytest.approx((steps[1, 0] - steps[0, 0]) / 0.01, rel=1e-3)


def test_a_pair_of_different_lenses_is_rectified() -> None:
    spheres = replace(PLAIN, distortion_model="double_sphere", distortion=(-0.17, 0.59))
    radtan = replace(PLAIN, distortion_model="radtan", distortion=RADTAN)
    rig = Rig(spheres, radtan, CAM1_FROM_CAM0)
    rectified = rectified_rig(rig)
    points, xy = _points(rectified, 3.0)
    in_cam0 = transform_points(rectified.cam0_from_rectified, points)
    left = rectified.rectify(_dots(cameras.project(spheres, in_cam0)), 0)
    in_cam1 = transform_points(CAM1_FROM_CAM0, in_cam0)
    right = rectified.rectify(_dots(cameras.project(radtan, in_cam1)), 1)
    expected = xy - (rectified.fx * rectified.baseline_m / 3.0, 0.0)
    np.testing.assert_allclose([_centroid(left, at) for at in xy], xy, atol=0.15)
    np.testing.assert_allclose([_centroid(right, at) for at in expected], expected, atol=0.15)


def test_pixels_beyond_the_field_of_view_are_black() -> None:
    # The rectified image is wider (128 degrees) than what this polynomial reaches (103 degrees).
    lens = Camera(640, 640, 160.0, 160.0, 320.0, 320.0, "equidistant", (-0.35, -0.05, 0.0, 0.0))
    rectified = rectified_rig(Rig(lens, lens, make_transform(np.eye(3), [-0.1, 0.0, 0.0])))
    white = rectified.rectify(np.full((640, 640), 255, np.uint8), 0)
    rays = np.abs(np.arange(640) - 320.0) / rectified.fx
    seen = np.isfinite(cameras.distort(lens, np.column_stack([rays, np.zeros(640)]))).all(axis=1)
    assert 0.3 < seen.mean() < 0.9
    np.testing.assert_array_equal(white[320] > 127, seen)


def test_mono_images_stay_as_recorded() -> None:
    rectified = rectified_rig(Rig(replace(PLAIN, distortion_model="radtan", distortion=RADTAN)))
    image = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    np.testing.assert_array_equal(rectified.rectify(image, 0), image)


def test_pixels_beyond_75_degrees_are_nan() -> None:
    wide = Camera(640, 640, 190.0, 190.0, 320.0, 320.0, "radtan", (1e-12, 0.0, 0.0, 0.0))
    rectified = rectified_rig(Rig(wide))
    angle = np.deg2rad([0.0, 60.0, 74.0, 76.0, 86.0])
    xy = np.column_stack([320.0 + 190.0 * np.tan(angle), np.full(5, 320.0)])
    finite = np.isfinite(rectified.undistort(xy)).all(axis=1)
    assert finite.tolist() == [True, True, True, False, False]


def test_rays_beyond_the_reach_of_the_lens_model_never_fall_into_the_image() -> None:
    # This polynomial turns round at a radius of 1.2; a ray at 1.4 comes back to 0.7.
    lens = replace(PLAIN, distortion_model="radtan", distortion=(-0.35, 0.05, 0.0, 0.0))
    far = np.array([[318.0 + 420.0 * r, 203.0] for r in (1.25, 1.4, 1.6, 10.0)])
    assert np.isnan(rectified_rig(Rig(lens)).distort(far)).any(axis=1).all()


# A lens that is not as calibrated


@pytest.mark.parametrize("coefficients", [RADTAN, ()])
def test_a_k1_error_is_added_to_the_lens(coefficients: tuple[float, ...]) -> None:
    model: DistortionModel = "radtan" if coefficients else "none"
    k1, *others = coefficients or (0.0, 0.0, 0.0, 0.0)
    seen = replace(PLAIN, distortion_model="radtan", distortion=(k1 + 0.01, *others))
    rectified = rectified_rig(Rig(replace(PLAIN, distortion_model=model, distortion=coefficients)))
    corrected = rectified.with_k1_error(0.02).with_k1_error(0.01)
    ideal = _points(rectified, 3.0)[1]
    at = cameras.distort(seen, (ideal - (PLAIN.cx, PLAIN.cy)) / (PLAIN.fx, PLAIN.fy))
    np.testing.assert_allclose(corrected.distort(ideal), at, atol=1e-9)
    np.testing.assert_allclose(corrected.undistort(at), ideal, atol=1e-6)
    assert corrected.k1_error == 0.01
    np.testing.assert_allclose(
        corrected.with_k1_error(0.0).undistort(at), rectified.undistort(at), atol=1e-9
    )


def test_a_k1_error_of_a_wide_lens_is_that_of_the_rectified_image() -> None:
    wide = replace(PLAIN, distortion_model="equidistant", distortion=EQUIDISTANT)
    rectified = rectified_rig(Rig(wide)).with_k1_error(0.01)
    assert rectified.lens is not None
    assert rectified.lens.distortion == (0.01, 0.0, 0.0, 0.0)
    assert rectified.lens.fx == rectified.fx


def test_a_corrected_lens_with_a_smaller_reach_loses_no_feature() -> None:
    folded = replace(PLAIN, distortion_model="radtan", distortion=(-0.28, 0.0, 0.0, 0.0))
    rectified = rectified_rig(Rig(folded))
    corrected = rectified.with_k1_error(-0.05)
    radius = np.linspace(0.0, 0.75, 200) * PLAIN.fx
    xy = np.column_stack([PLAIN.cx + radius, np.full(200, PLAIN.cy)])
    before, after = rectified.undistort(xy), corrected.undistort(xy)
    assert np.isnan(before).any() and not np.isnan(before).all()
    np.testing.assert_array_equal(np.isnan(after), np.isnan(before))


def test_a_k1_error_of_both_lenses_changes_disparities_and_rows() -> None:
    ideal = replace(rectified_rig(_ideal_pair(-0.5)), disparity_offset_px=0.3)
    wrong = ideal.with_k1_error(0.03)
    rng = np.random.default_rng(0)
    xy = rng.uniform((0.3 * ideal.width, 0), (ideal.width, ideal.height), (50, 2))
    disparity = rng.uniform(2.0, 80.0, 50)
    for rig in (ideal, wrong):
        right_xy = rig.right_pixels(xy, disparity)
        assert rig.ideal_disparity(xy, right_xy) == pytest.approx(disparity, abs=0.05)
    # Each image is bent on its own: the right pixel of an ideal one is bent where it is.
    bent = wrong.distort(xy)
    right = ideal.right_pixels(xy, disparity) + (0.3, 0.0)
    assert wrong.right_pixels(bent, disparity) + (0.3, 0.0) == pytest.approx(
        wrong.distort(right), abs=0.01
    )
