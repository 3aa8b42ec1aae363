"""Detection and poses of markers against rendered views with a known pose."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from marker_views import Placed, developed, looking_at, random_background, render

from vo.base.geometry.transforms import inverse, rotation_angle, se3_log
from vo.base.types import Bytes, Camera, Floats
from vo.engine.markers.dictionaries import STANDARD, dictionary
from vo.engine.markers.marker_problem import square_points
from vo.tools.markers.detection import MarkerDetector, Refinement, find_dictionary
from vo.tools.markers.image_markers import PlanePose
from vo.tools.markers.plane_pose import plane_pose
from vo.tools.markers.search import MarkerFinder, find_too_small

LENGTH_M = 0.16
SHAPE = (480, 640)


def _view(
    camera: Camera, rng: np.random.Generator, cam_from_marker: Floats, name: str, number: int = 7
) -> Bytes:
    placed = Placed(name, number, LENGTH_M, cam_from_marker)
    background = random_background(rng, (camera.height, camera.width))
    return developed(render(camera, placed, background), rng)


def _pose(camera: Camera, image: Bytes, name: str, number: int = 7) -> PlanePose:
    frame = MarkerFinder(MarkerDetector(name), LENGTH_M, camera).find(image)
    (marker,) = frame.markers
    assert marker.id == number
    assert marker.pose is not None
    return marker.pose


def _errors(pose: PlanePose, truth: Floats) -> tuple[float, float]:
    """Millimetres and degrees."""
    apart = np.linalg.norm(pose.cam_from_marker[:3, 3] - truth[:3, 3])
    turned = rotation_angle(pose.cam_from_marker[:3, :3] @ truth[:3, :3].T)
    return 1e3 * float(apart), float(np.rad2deg(turned))


@pytest.mark.parametrize("name", ["4X4_50", "APRILTAG_36H11", "ARUCO_ORIGINAL", STANDARD])
def test_a_pose_at_one_metre_is_right_to_half_a_millimetre(
    camera: Camera, rng: np.random.Generator, name: str
) -> None:
    truth = looking_at(np.array([0.1, -0.05, 1.0]), 0.5, 1.0, 0.3)
    pose = _pose(camera, _view(camera, rng, truth, name), name)
    apart_mm, turned_deg = _errors(pose, truth)
    assert apart_mm < 0.5
    assert turned_deg < 0.15
    assert not pose.is_ambiguous
    assert pose.error_px < 0.1


def test_a_bent_image_gives_the_same_accuracy(rng: np.random.Generator) -> None:
    lens = (-0.25, 0.06, 0.0005, -0.0005)
    camera = Camera(640, 480, 420.0, 420.0, 322.0, 238.0, "radtan", lens)
    truth = looking_at(np.array([0.35, 0.2, 0.7]), 0.4, 2.0, 1.3)
    apart_mm, turned_deg = _errors(
        _pose(camera, _view(camera, rng, truth, "4X4_50"), "4X4_50"), truth
    )
    assert apart_mm < 0.7
    assert turned_deg < 0.2


def test_the_stated_uncertainty_covers_the_error(camera: Camera, rng: np.random.Generator) -> None:
    squared = []
    for n in range(12):
        position = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), 1.0])
        truth = looking_at(position, rng.uniform(0.3, 1.0), rng.uniform(0, 6), rng.uniform(0, 6))
        pose = _pose(camera, _view(camera, rng, truth, "4X4_50", n), "4X4_50", n)
        xi = se3_log(truth @ inverse(pose.cam_from_marker))
        squared.append(xi @ np.linalg.solve(pose.covariance, xi))
    assert 0.3 < np.mean(squared) < 8.0  # 6 if it is exact


def test_lines_are_more_accurate_than_corners_by_gradients(
    camera: Camera, rng: np.random.Generator
) -> None:
    truth = looking_at(np.array([0.1, 0.1, 1.5]), 0.6, 0.5, 0.2)
    image = _view(camera, rng, truth, "4X4_50")
    points = square_points(LENGTH_M) @ truth[:3, :3].T + truth[:3, 3]
    expected = points[:, :2] / points[:, 2:] * 600.0 + (319.5, 239.5)
    error = {}
    for kind in (Refinement.LINES, Refinement.SUBPIX):
        (marker,) = MarkerDetector("4X4_50", kind).detect(image)
        error[kind] = np.sqrt(np.mean((marker.corners - expected) ** 2))
    assert error[Refinement.LINES] < 0.04
    assert error[Refinement.LINES] < 0.5 * error[Refinement.SUBPIX]


def test_exact_corners_give_the_exact_pose_and_its_mirror_image(camera: Camera) -> None:
    truth = looking_at(np.array([0.2, 0.1, 2.0]), 0.4, 1.0, 0.0)
    points = square_points(LENGTH_M) @ truth[:3, :3].T + truth[:3, 3]
    pixels = points[:, :2] / points[:, 2:] * 600.0 + (319.5, 239.5)
    pose = plane_pose(camera, square_points(LENGTH_M), pixels, 0.02)
    assert pose is not None
    np.testing.assert_allclose(pose.cam_from_marker, truth, atol=1e-7)
    assert pose.other is not None
    assert pose.other_error_px > 0.05
    assert plane_pose(camera, square_points(LENGTH_M), pixels, 2.0).is_ambiguous  # type: ignore[union-attr]


def test_a_face_on_view_far_away_is_ambiguous(camera: Camera, rng: np.random.Generator) -> None:
    truth = looking_at(np.array([0.0, 0.0, 4.5]), 0.15, 1.0, 0.3)
    pose = _pose(camera, _view(camera, rng, truth, "4X4_50"), "4X4_50")
    assert pose.is_ambiguous or _errors(pose, truth)[1] < 5.0


def test_part_of_a_side_may_be_covered(camera: Camera, rng: np.random.Generator) -> None:
    truth = looking_at(np.array([0.0, 0.0, 0.8]), 0.5, 1.0, 0.1)
    image = _view(camera, rng, truth, "6X6_250")
    points = square_points(LENGTH_M) @ truth[:3, :3].T + truth[:3, 3]
    edge = points[:2].mean(axis=0)
    u, v = (edge[:2] / edge[2] * 600.0 + (319.5, 239.5)).round().astype(int)
    covered = image.copy()
    covered[v - 8 : v, u - 6 : u + 6] = 120  # over the margin
    apart_mm, turned_deg = _errors(_pose(camera, covered, "6X6_250"), truth)
    assert apart_mm < 1.0
    assert turned_deg < 0.3


@pytest.mark.parametrize("name", ["4X4_50", "5X5_100", "APRILTAG_36H11", "APRILTAG_16H5", STANDARD])
def test_auto_finds_the_dictionary(camera: Camera, rng: np.random.Generator, name: str) -> None:
    images = []
    for n in (1, 13, 20):
        truth = looking_at(np.array([0.05 * n - 0.5, 0.0, 1.0]), 0.4, 1.0, 0.2)
        images.append(_view(camera, rng, truth, name, n))
    found = find_dictionary(images, "the images")
    expected = {"5X5_100": "5X5_50"}.get(name, name)  # which contains the ids seen
    assert found == expected


def test_an_image_without_markers_shows_none(rng: np.random.Generator) -> None:
    noise = rng.integers(0, 255, (240, 320), dtype=np.uint8)
    blocks = np.kron(rng.integers(0, 2, (30, 40)), np.ones((8, 8))).astype(np.uint8) * 200
    assert find_dictionary([noise, blocks], "the images") is None


def test_a_bright_rectangle_in_a_dark_frame_is_no_evidence_of_a_dictionary() -> None:
    image = np.full((240, 320), 200, np.uint8)
    image[60:130, 80:150] = np.kron(
        np.asarray(dictionary("ARUCO_ORIGINAL").generateImageMarker(1023, 7)), np.ones((10, 10))
    )
    assert find_dictionary([image], "the image") is None


def test_a_marker_that_is_too_small_is_found_for_the_message(
    camera: Camera, rng: np.random.Generator
) -> None:
    truth = looking_at(np.array([0.0, 0.0, 11.0]), 0.1, 1.0, 0.0)
    image = _view(camera, rng, truth, "4X4_50", 3)
    detector = MarkerDetector("4X4_50")
    assert detector.detect(image) == []
    small = find_too_small(detector, image)
    assert small is not None
    assert small.id == 3
    assert small.side_px == pytest.approx(600.0 * LENGTH_M / 11.0, rel=0.1)


@pytest.mark.parametrize(("side", "is_found"), [(60, True), (14, False)])
def test_a_small_likeness_with_uneven_cells_is_no_marker(side: int, is_found: bool) -> None:
    """Textures have many of them; a large one is a marker in uneven light."""
    rng = np.random.default_rng(8)
    pattern = np.asarray(dictionary("4X4_50").generateImageMarker(5, 6), np.float64) / 255.0
    cells = np.where(pattern > 0.5, rng.uniform(110, 250, (6, 6)), rng.uniform(0, 75, (6, 6)))
    size = 6 * (side // 6 + 1)
    image = np.full((120, 120), 200.0)
    image[30 : 30 + size, 30 : 30 + size] = np.kron(cells, np.ones((size // 6, size // 6)))
    image = cv2.GaussianBlur(image, (0, 0), 0.5)
    found = MarkerDetector("4X4_50").detect(np.asarray(image, np.uint8))
    assert [marker.id for marker in found] == ([5] if is_found else [])


def _on_white(cells: np.ndarray, cell_px: int, blur_px: float) -> np.ndarray:
    square = np.kron(20.0 + 200.0 * cells, np.ones((cell_px, cell_px)))
    image = np.pad(square, 30, constant_values=220.0)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), np.uint8)


@pytest.mark.parametrize("blur_px", [0.5, 2.0])
def test_squares_of_other_cells_that_read_as_codes_are_no_markers(blur_px: float) -> None:
    """One in twenty of 7 x 7 cells does in 4X4_1000; blur makes cells of markers uneven too."""
    detector = MarkerDetector("4X4_1000")
    for seed in range(100):
        other = np.pad(np.random.default_rng(seed).integers(0, 2, (7, 7)), 1)
        assert detector.detect(_on_white(other, 6, 0.5)) == []
    for number in range(0, 1000, 40):
        cells = np.asarray(dictionary("4X4_1000").generateImageMarker(number, 6)) / 255
        assert [each.id for each in detector.detect(_on_white(cells, 9, blur_px))] == [number]
