"""Triangles in images: where they are, what hides what, and how they are placed."""

from __future__ import annotations

import numpy as np

from vo.base.geometry import cameras
from vo.base.types import Camera
from vo.recordings.formats.mesh import Mesh
from vo.tools.rendering.rasterizer import draw, shading
from vo.tools.rendering.render import ModelPose, axes, posed, standing

CAMERA = Camera(80, 60, 50.0, 50.0, 39.5, 29.5)
GREY = np.full((60, 80, 3), 100, np.uint8)
SQUARE = np.array([[-0.5, -0.3, 0], [0.5, -0.3, 0], [0.5, 0.3, 0], [-0.5, 0.3, 0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def square(depth: float) -> np.ndarray:
    return SQUARE + (0.0, 0.0, depth)


def test_a_square_is_drawn_where_it_is() -> None:
    """1 m x 0.6 m at 2 m: 25 x 15 pixels around the centre, to a quarter of a pixel."""
    rgb = np.tile(np.array([[200, 150, 50]], np.uint8), (4, 1))
    drawn = draw(GREY, CAMERA, square(2.0), TRIANGLES, rgb, np.ones(2))
    ratio = (drawn[..., 0].astype(float) - 100.0) / (50.0 - 100.0)  # blue
    assert np.isclose(ratio.sum(), 25 * 15, rtol=0.03)
    rows, columns = np.nonzero(ratio > 0.99)
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (28, 51, 23, 36)
    assert drawn[29, 39].tolist() == [50, 150, 200]  # BGR
    assert (GREY == 100).all()  # the given image stays


def test_the_nearer_one_is_seen() -> None:
    vertices = np.concatenate([square(2.0), square(3.0), square(1.5) * (0.2, 0.2, 1.0)])
    triangles = np.concatenate([TRIANGLES, TRIANGLES + 4, TRIANGLES + 8])
    rgb = np.repeat(np.array([[200, 0, 0], [0, 200, 0], [0, 0, 200]], np.uint8), 4, axis=0)
    for order in (np.arange(6), np.arange(6)[::-1]):
        drawn = draw(GREY, CAMERA, vertices, triangles[order], rgb, np.ones(6))
        assert drawn[29, 39].tolist() == [200, 0, 0]
        assert drawn[29, 30].tolist() == [0, 0, 200]
        assert not (drawn == [0, 200, 0]).all(axis=2).any()


def test_what_is_behind_the_camera_or_beside_it_is_not_drawn() -> None:
    rgb = np.zeros((4, 3), np.uint8)
    for vertices in (square(-2.0), square(2.0) + (50.0, 0, 0), square(0.0)):
        assert (draw(GREY, CAMERA, vertices, TRIANGLES, rgb, np.ones(2)) == GREY).all()


def test_a_distorted_lens_bends_the_model() -> None:
    lens = Camera(80, 60, 50.0, 50.0, 39.5, 29.5, "radtan", (-0.3, 0.05, 0.0, 0.0))
    vertices = square(2.0) * (0.1, 0.1, 1.0) + (1.2, 0.8, 0.0)
    drawn = draw(GREY, lens, vertices, TRIANGLES, np.zeros((4, 3), np.uint8), np.ones(2))
    rows, columns = np.nonzero((drawn < 50).all(axis=2))
    centre = cameras.project(lens, vertices.mean(axis=0)[None])[0]
    np.testing.assert_allclose((columns.mean(), rows.mean()), centre, atol=0.5)


def test_the_model_stands_on_its_place() -> None:
    model = axes()
    for up, top in (("y", 1), ("z", 2)):
        for world_up, height in (("-y", lambda xyz: 2.0 - xyz[:, 1]), ("z", lambda xyz: xyz[:, 2])):
            foot = np.array([1.0, 2.0, 0.0])
            model_pose = ModelPose(foot, 0.5, up, world_up)
            vertices = posed(standing(model, model_pose), model_pose)
            assert np.isclose(np.ptp(vertices, axis=0).max(), 0.5)
            assert np.isclose(height(vertices).min(), 0.0)
            assert model.vertices[height(vertices).argmax(), top] == 1.0
    own = standing(model, ModelPose(np.zeros(3), None, "-y"))
    assert np.isclose(np.ptp(own, axis=0).max(), 1.03)
    shade = shading(own, model.triangles)
    assert 0.4 < shade.min() < shade.max() <= 1.0


def test_axes_are_a_closed_mesh() -> None:
    model: Mesh = axes()
    edges = np.sort(model.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 2).all()
