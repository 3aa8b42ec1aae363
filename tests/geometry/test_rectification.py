from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vo.errors import CalibrationError
from vo.geometry import cameras
from vo.geometry.rectification import RectifiedRig, rectified_rig
from vo.geometry.transforms import inverse, make_transform, so3_exp, transform_points
from vo.types import Bytes, Camera, DistortionModel, Floats, Rig

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


def _points(working: RectifiedRig, depth: float) -> tuple[Floats, Floats]:
    """Points at a depth in the working camera's frame, and their ideal pixels."""
    u, v = np.meshgrid(np.arange(140.0, WIDTH - 60, 60), np.arange(50.0, HEIGHT - 40, 60))
    xy = np.column_stack([u.ravel(), v.ravel()]) + (0.3, -0.4)
    return working.back_project(xy, np.full(len(xy), depth)), xy


# Rectified pairs


def test_a_rectified_pair_passes_untouched() -> None:
    working = rectified_rig(_ideal_pair(-0.12))
    assert (working.fx, working.fy, working.cx, working.cy) == (420.0, 415.0, 318.0, 203.0)
    assert (working.width, working.height) == (WIDTH, HEIGHT)
    assert working.baseline_m == 0.12
    assert working.is_stereo
    np.testing.assert_array_equal(working.cam0_from_rectified, np.eye(4))
    image = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    for side in (0, 1):
        np.testing.assert_array_equal(working.rectify(image, side), image)


@pytest.mark.parametrize("x", [0.12, 0.0])
def test_a_right_camera_that_is_not_to_the_right_is_an_error(x: float) -> None:
    with pytest.raises(CalibrationError, match="cam1 must be to the right of cam0"):
        rectified_rig(_ideal_pair(x))


@pytest.mark.parametrize("model", ["radtan", "equidistant"])
@pytest.mark.parametrize("translation", [(0.11, 0.003, -0.004), (-0.01, 0.2, 0.0), (0, 0, 0)])
def test_an_unrectified_pair_must_lie_left_to_right_as_well(
    model: DistortionModel, translation: tuple[float, float, float]
) -> None:
    coefficients = RADTAN if model == "radtan" else EQUIDISTANT
    motion = make_transform(CAM1_FROM_CAM0[:3, :3], np.array(translation))
    with pytest.raises(CalibrationError, match="cam1 must be to the right of cam0"):
        rectified_rig(_pair(model, coefficients, motion))


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
def test_rectified_points_share_their_row_and_show_their_depth(
    model: DistortionModel, coefficients: tuple[float, ...], depth: float
) -> None:
    rig = _pair(model, coefficients)
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    working = rectified_rig(rig)
    points, xy = _points(working, depth)
    in_cam0 = transform_points(working.cam0_from_rectified, points)
    in_cam1 = transform_points(rig.cam1_from_cam0, in_cam0)
    left = working.rectify(_dots(cameras.project(rig.cam0, in_cam0)), 0)
    right = working.rectify(_dots(cameras.project(rig.cam1, in_cam1)), 1)
    expected = xy - (working.fx * working.baseline_m / depth, 0.0)
    assert left.shape == right.shape == (working.height, working.width)
    found_left = np.array([_centroid(left, at) for at in xy])
    found_right = np.array([_centroid(right, at) for at in expected])
    np.testing.assert_allclose(found_left, xy, atol=0.1)
    np.testing.assert_allclose(found_right, expected, atol=0.1)
    assert np.median(np.abs(found_left[:, 1] - found_right[:, 1])) < 0.03


@pytest.mark.parametrize(("model", "coefficients"), PAIRS)
def test_rectification_only_turns_cam0(
    model: DistortionModel, coefficients: tuple[float, ...]
) -> None:
    working = rectified_rig(_pair(model, coefficients))
    cam0_from_rectified = working.cam0_from_rectified
    np.testing.assert_allclose(cam0_from_rectified[:3, 3], 0.0, atol=1e-12)
    assert working.baseline_m == pytest.approx(np.linalg.norm(CAM1_FROM_CAM0[:3, 3]), rel=1e-9)
    # The right camera lies on the working camera's x axis, at the baseline.
    centre = transform_points(inverse(cam0_from_rectified), inverse(CAM1_FROM_CAM0)[None, :3, 3])
    np.testing.assert_allclose(centre, [[working.baseline_m, 0.0, 0.0]], atol=1e-9)


@pytest.mark.parametrize(("model", "coefficients"), PAIRS)
def test_rectified_images_keep_a_useful_field_of_view(
    model: DistortionModel, coefficients: tuple[float, ...]
) -> None:
    working = rectified_rig(_pair(model, coefficients))
    white = np.full((HEIGHT, WIDTH), 255, np.uint8)
    for side in (0, 1):
        assert np.mean(working.rectify(white, side) == 255) > 0.85
    assert 0.7 < working.fx / PLAIN.fx < 1.4


def test_rectified_stereo_pixels_are_ideal_already() -> None:
    working = rectified_rig(_pair("radtan", RADTAN))
    xy = np.random.default_rng(0).uniform((0, 0), (WIDTH, HEIGHT), (50, 2))
    np.testing.assert_array_equal(working.undistort(xy), xy)
    np.testing.assert_array_equal(working.distort(xy), xy)


# A single camera

NARROW, WIDE = PAIRS[1:4], PAIRS[4:]


def test_a_plain_single_camera_passes_untouched() -> None:
    working = rectified_rig(Rig(PLAIN))
    assert not working.is_stereo and working.baseline_m == 0.0
    xy = np.random.default_rng(0).uniform((0, 0), (WIDTH, HEIGHT), (50, 2))
    np.testing.assert_array_equal(working.undistort(xy), xy)


@pytest.mark.parametrize(("model", "coefficients"), NARROW)
def test_mono_pixels_survive_the_way_to_ideal_and_back(
    model: DistortionModel, coefficients: tuple[float, ...]
) -> None:
    camera = replace(PLAIN, distortion_model=model, distortion=coefficients)
    working = rectified_rig(Rig(camera))
    xy = np.random.default_rng(0).uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (500, 2))
    ideal = working.undistort(xy)
    assert np.isfinite(ideal).all()
    assert np.linalg.norm(ideal - xy, axis=1).max() > 3.0
    np.testing.assert_allclose(working.distort(ideal), xy, atol=1e-6)


@pytest.mark.parametrize(("model", "coefficients"), NARROW)
def test_ideal_pixels_are_those_of_a_pinhole(
    model: DistortionModel, coefficients: tuple[float, ...]
) -> None:
    camera = replace(PLAIN, distortion_model=model, distortion=coefficients)
    working = rectified_rig(Rig(camera))
    points = np.random.default_rng(0).uniform((-2, -1, 4), (2, 1, 9), (100, 3))
    ideal = working.undistort(cameras.project(camera, points))
    np.testing.assert_allclose(ideal, working.project(points), atol=1e-6)
    np.testing.assert_allclose(working.back_project(ideal, points[:, 2]), points, atol=1e-6)


@pytest.mark.parametrize(("model", "coefficients"), WIDE)
def test_a_single_wide_camera_is_rectified(
    model: DistortionModel, coefficients: tuple[float, ...]
) -> None:
    camera = replace(PLAIN, distortion_model=model, distortion=coefficients)
    working = rectified_rig(Rig(camera))
    assert not working.is_stereo
    np.testing.assert_array_equal(working.cam0_from_rectified, np.eye(4))
    points, xy = _points(working, 2.0)
    image = working.rectify(_dots(cameras.project(camera, points)), 0)
    np.testing.assert_allclose([_centroid(image, at) for at in xy], xy, atol=0.1)
    np.testing.assert_array_equal(working.undistort(xy), xy)
    # What is on the axis keeps its size.
    steps = cameras.distort(camera, np.array([[0.0, 0.0], [0.01, 0.0]]))
    assert working.fx == pytest.approx((steps[1, 0] - steps[0, 0]) / 0.01, rel=1e-3)


def test_a_pair_of_different_lenses_is_rectified() -> None:
    spheres = replace(PLAIN, distortion_model="double_sphere", distortion=(-0.17, 0.59))
    radtan = replace(PLAIN, distortion_model="radtan", distortion=RADTAN)
    rig = Rig(spheres, radtan, CAM1_FROM_CAM0)
    working = rectified_rig(rig)
    points, xy = _points(working, 3.0)
    in_cam0 = transform_points(working.cam0_from_rectified, points)
    left = working.rectify(_dots(cameras.project(spheres, in_cam0)), 0)
    in_cam1 = transform_points(CAM1_FROM_CAM0, in_cam0)
    right = working.rectify(_dots(cameras.project(radtan, in_cam1)), 1)
    expected = xy - (working.fx * working.baseline_m / 3.0, 0.0)
    np.testing.assert_allclose([_centroid(left, at) for at in xy], xy, atol=0.15)
    np.testing.assert_allclose([_centroid(right, at) for at in expected], expected, atol=0.15)


def test_what_a_wide_lens_does_not_see_is_black() -> None:
    # The working image is wider (128 degrees) than what this polynomial reaches (103 degrees).
    lens = Camera(640, 640, 160.0, 160.0, 320.0, 320.0, "equidistant", (-0.35, -0.05, 0.0, 0.0))
    working = rectified_rig(Rig(lens, lens, make_transform(np.eye(3), [-0.1, 0.0, 0.0])))
    white = working.rectify(np.full((640, 640), 255, np.uint8), 0)
    rays = np.abs(np.arange(640) - 320.0) / working.fx
    seen = np.isfinite(cameras.distort(lens, np.column_stack([rays, np.zeros(640)]))).all(axis=1)
    assert 0.3 < seen.mean() < 0.9
    np.testing.assert_array_equal(white[320] > 127, seen)


def test_mono_images_stay_as_recorded() -> None:
    working = rectified_rig(Rig(replace(PLAIN, distortion_model="radtan", distortion=RADTAN)))
    image = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    np.testing.assert_array_equal(working.rectify(image, 0), image)


def test_pixels_that_no_useful_ray_reaches_are_nan() -> None:
    wide = Camera(640, 640, 190.0, 190.0, 320.0, 320.0, "radtan", (1e-12, 0.0, 0.0, 0.0))
    working = rectified_rig(Rig(wide))
    angle = np.deg2rad([0.0, 60.0, 74.0, 76.0, 86.0])
    xy = np.column_stack([320.0 + 190.0 * np.tan(angle), np.full(5, 320.0)])
    finite = np.isfinite(working.undistort(xy)).all(axis=1)
    assert finite.tolist() == [True, True, True, False, False]


def test_rays_beyond_the_reach_of_the_lens_model_never_fall_into_the_image() -> None:
    # This polynomial turns round at a radius of 1.2; a ray at 1.4 comes back to 0.7.
    lens = replace(PLAIN, distortion_model="radtan", distortion=(-0.35, 0.05, 0.0, 0.0))
    far = np.array([[318.0 + 420.0 * r, 203.0] for r in (1.25, 1.4, 1.6, 10.0)])
    assert np.isnan(rectified_rig(Rig(lens)).distort(far)).any(axis=1).all()


# A lens that is not as calibrated


@pytest.mark.parametrize("coefficients", [RADTAN, ()])
def test_a_lens_error_is_one_of_k1(coefficients: tuple[float, ...]) -> None:
    model: DistortionModel = "radtan" if coefficients else "none"
    k1, *others = coefficients or (0.0, 0.0, 0.0, 0.0)
    seen = replace(PLAIN, distortion_model="radtan", distortion=(k1 + 0.01, *others))
    working = rectified_rig(Rig(replace(PLAIN, distortion_model=model, distortion=coefficients)))
    corrected = working.with_k1_error(0.02).with_k1_error(0.01)
    ideal = _points(working, 3.0)[1]
    at = cameras.distort(seen, (ideal - (PLAIN.cx, PLAIN.cy)) / (PLAIN.fx, PLAIN.fy))
    np.testing.assert_allclose(corrected.distort(ideal), at, atol=1e-9)
    np.testing.assert_allclose(corrected.undistort(at), ideal, atol=1e-6)
    assert corrected.k1_error == 0.01
    np.testing.assert_allclose(
        corrected.with_k1_error(0.0).undistort(at), working.undistort(at), atol=1e-9
    )


def test_images_of_a_wide_lens_are_corrected_as_they_are_worked_on() -> None:
    wide = replace(PLAIN, distortion_model="equidistant", distortion=EQUIDISTANT)
    working = rectified_rig(Rig(wide)).with_k1_error(0.01)
    assert working.lens is not None
    assert working.lens.distortion == (0.01, 0.0, 0.0, 0.0)
    assert working.lens.fx == working.fx


def test_a_corrected_lens_that_folds_earlier_loses_no_feature() -> None:
    folded = replace(PLAIN, distortion_model="radtan", distortion=(-0.28, 0.0, 0.0, 0.0))
    working = rectified_rig(Rig(folded))
    corrected = working.with_k1_error(-0.05)
    radius = np.linspace(0.0, 0.75, 200) * PLAIN.fx
    xy = np.column_stack([PLAIN.cx + radius, np.full(200, PLAIN.cy)])
    before, after = working.undistort(xy), corrected.undistort(xy)
    assert np.isnan(before).any() and not np.isnan(before).all()
    np.testing.assert_array_equal(np.isnan(after), np.isnan(before))
