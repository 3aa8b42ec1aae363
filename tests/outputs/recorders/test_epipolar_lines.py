import numpy as np
import pytest

from vo.base.geometry import cameras
from vo.base.geometry.transforms import inverse, make_transform, so3_exp, transform_points
from vo.base.records.snapshot import View
from vo.base.types import Camera
from vo.outputs.recorders.view_layer import epipolar_lines

PLAIN = Camera(width=640, height=480, fx=400.0, fy=410.0, cx=320.0, cy=240.0)
DISTORTED = Camera(640, 480, 400.0, 410.0, 320.0, 240.0, "radtan", (-0.25, 0.05, 0.001, -0.001))


def seen(camera: Camera, points: np.ndarray) -> np.ndarray:
    return cameras.distort(camera, points[:, :2] / points[:, 2:])


def make_view(camera: Camera) -> View:
    empty = np.empty((0, 2), np.float32)
    lens = camera if camera.is_distorted else None
    turn = make_transform(so3_exp(np.array([0.01, -0.02, 0.03])), np.zeros(3))
    image = np.zeros((480, 640), np.uint8)
    codes = np.empty(0, np.uint8)
    return View(image, None, empty, codes, empty, camera.matrix, lens=lens, cam0_from_image0=turn)


def distance_to_curve(point: np.ndarray, curve: np.ndarray) -> float:
    """Distance of a pixel to a polyline of pixels (k, 2)."""
    start, along = curve[:-1], np.diff(curve, axis=0)
    share = ((point - start) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12)
    nearest = start + share.clip(0.0, 1.0)[:, None] * along
    return float(np.linalg.norm(nearest - point, axis=1).min())


@pytest.mark.parametrize("camera, within_px", [(PLAIN, 1e-3), (DISTORTED, 0.5)])
def test_lines_pass_through_the_points_in_this_image(camera, within_px):
    rng = np.random.default_rng(1)
    view = make_view(camera)
    before = make_transform(so3_exp(np.array([0.0, 0.4, 0.0])), np.array([1.0, 0.0, 2.0]))
    now = before @ make_transform(so3_exp(np.array([0.01, 0.05, 0.0])), np.array([0.1, 0.0, 0.3]))
    in_image = np.column_stack([rng.uniform(-1, 1, (40, 2)), rng.uniform(3.0, 20.0, 40)])
    world = transform_points(before @ view.cam0_from_image0, in_image)
    then_xy = seen(camera, in_image).astype(np.float32)
    now_xy = seen(camera, transform_points(inverse(now @ view.cam0_from_image0), world))
    lines = epipolar_lines(view, then_xy, before, now)
    assert len(lines) == 40
    distances = [distance_to_curve(p, line) for p, line in zip(now_xy, lines, strict=True)]
    assert max(distances) < within_px


def test_there_are_no_lines_without_camera_motion():
    view = make_view(PLAIN)
    xy = np.array([[100.0, 100.0]], dtype=np.float32)
    assert len(epipolar_lines(view, xy, np.eye(4), np.eye(4))) == 0
