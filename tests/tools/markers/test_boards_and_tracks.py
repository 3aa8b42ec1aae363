"""Boards, and ambiguous poses decided by the views around them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from marker_views import Placed, developed, looking_at, random_background, render

from vo.base.errors import ConfigError
from vo.base.geometry.transforms import make_transform, rotation_angle
from vo.base.types import Camera, Floats
from vo.engine.markers.marker_problem import square_points
from vo.tools.calibrating.printing import draw_board
from vo.tools.markers.boards import CharucoBoard, check_length, make_charuco, make_grid
from vo.tools.markers.consistency import consistent
from vo.tools.markers.detection import MarkerDetector
from vo.tools.markers.image_markers import DetectedMarker, FrameMarkers, Marker
from vo.tools.markers.plane_pose import plane_pose
from vo.tools.markers.search import MarkerFinder


def test_a_grid_of_markers_is_located_by_all_of_them(
    camera: Camera, rng: np.random.Generator
) -> None:
    board = make_grid(3, 2, 0.06, 0.02, "4X4_50")
    truth = looking_at(np.array([0.05, 0.02, 0.8]), 0.5, 1.0, 0.1)
    image = random_background(rng, (480, 640)).astype(np.float64)
    for number in range(6):
        placed = truth @ make_transform(np.eye(3), board.corners(number).mean(axis=0))
        image = render(camera, Placed("4X4_50", number, 0.06, placed), image.astype(np.uint8))
    frame = MarkerFinder(MarkerDetector("4X4_50"), 0.06, camera, board).find(developed(image, rng))
    assert len(frame.markers) == 6
    assert frame.board is not None
    np.testing.assert_allclose(frame.board.cam_from_marker[:3, 3], truth[:3, 3], atol=5e-4)
    turned = rotation_angle(frame.board.cam_from_marker[:3, :3] @ truth[:3, :3].T)
    assert np.rad2deg(turned) < 0.1
    single = frame.markers[0].pose
    assert single is not None
    assert frame.board.sigma_deg < 0.6 * single.sigma_deg


def test_a_charuco_board_has_its_origin_in_the_middle(camera: Camera) -> None:
    board = make_charuco(6, 4, 0.03, 0.022, "4X4_50")
    drawn = cv2.copyMakeBorder(
        draw_board(board, 40), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255
    )
    truth = looking_at(np.array([0.02, 0.0, 0.35]), 0.35, 1.0, 0.1)
    size = 0.03 / 40.0
    height, width = drawn.shape
    to_board = np.array(
        [[size, 0, -0.5 * (width - 1) * size], [0, -size, 0.5 * (height - 1) * size], [0, 0, 1]]
    )
    to_image = camera.matrix @ truth[:3, [0, 1, 3]] @ to_board
    image = cv2.warpPerspective(drawn, to_image, (640, 480), flags=cv2.INTER_AREA, borderValue=128)
    frame = MarkerFinder(MarkerDetector("4X4_50"), 0.022, camera, CharucoBoard(board)).find(
        np.asarray(image, dtype=np.uint8)
    )
    assert frame.board is not None
    np.testing.assert_allclose(frame.board.cam_from_marker[:3, 3], truth[:3, 3], atol=1.5e-3)
    turned = rotation_angle(frame.board.cam_from_marker[:3, :3] @ truth[:3, :3].T)
    assert np.rad2deg(turned) < 1.0


def _exact(camera: Camera, truth: Floats, noise: Floats, stamp_ns: int) -> FrameMarkers:
    points = square_points(0.16) @ truth[:3, :3].T + truth[:3, 3]
    pixels = points[:, :2] / points[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    detected = DetectedMarker(5, pixels + noise, 0.3)
    pose = plane_pose(camera, square_points(0.16), detected.corners, detected.sigma_px)
    assert pose is not None
    return FrameMarkers(stamp_ns // 10**8, stamp_ns, (Marker(detected, pose),))


def test_wrong_and_ambiguous_poses_follow_the_clear_ones(camera: Camera) -> None:
    rng = np.random.default_rng(0)
    truths, frames = [], []
    for n in range(30):  # comes near, tilted, from where the tilt is hardly visible
        truths.append(looking_at(np.array([0.1, 0.0, 5.0 - 0.14 * n]), 0.5, 1.0, 0.02 * n))
        frames.append(_exact(camera, truths[-1], rng.normal(0.0, 0.3, (4, 2)), n * 10**8))

    def wrong(given: list[FrameMarkers]) -> int:
        poses = [frame.markers[0].pose for frame in given]
        turned = [
            rotation_angle(pose.cam_from_marker[:3, :3] @ truth[:3, :3].T)
            for pose, truth in zip(poses, truths, strict=True)
            if pose is not None
        ]
        return int(np.sum(np.rad2deg(turned) > 20.0))

    assert wrong(frames) >= 2
    decided = consistent(frames)
    assert wrong(decided) == 0
    before, after = (
        sum(f.markers[0].pose.is_ambiguous for f in each)  # type: ignore[union-attr]
        for each in (frames, decided)
    )
    assert after < 0.3 * before


def test_two_markers_of_one_id_are_left_as_they_are(camera: Camera) -> None:
    truth = looking_at(np.array([0.1, 0.0, 2.0]), 0.5, 1.0, 0.0)
    frame = _exact(camera, truth, np.zeros((4, 2)), 0)
    twice = replace(frame, markers=frame.markers * 2)
    assert twice.repeated_ids == (5,)
    (result,) = consistent([twice])
    assert [m.pose for m in result.markers] == [m.pose for m in twice.markers]


@pytest.mark.parametrize(
    ("length", "words"), [(160.0, "not millimetres: 0.16"), (0.0, "in metres"), (-1.0, "metres")]
)
def test_a_length_in_another_unit_is_told(length: float, words: str) -> None:
    with pytest.raises(ConfigError, match=words.replace(".", r"\.")):
        check_length(length)
