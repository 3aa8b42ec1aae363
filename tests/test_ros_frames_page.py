"""The conversion to ROS on the page docs/ros-frames.md, against samples of the disturbance."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vo.base.types import Floats

PAGE = Path(__file__).resolve().parents[1] / "docs" / "ros-frames.md"
SAMPLES = 200_000


@pytest.fixture(scope="module")
def to_ros() -> Any:
    code = PAGE.read_text("utf-8").partition("```python\n")[2].partition("```")[0]
    names: dict[str, Any] = {}
    exec(code, names)
    return names["to_ros"]


def _rotations(vectors: Floats) -> Floats:
    """(N, 3, 3) rotations by (N, 3) rotation vectors (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    axis = vectors / angle[:, 0]
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    cross -= cross.transpose(0, 2, 1)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _transform(rotation: list[float], translation: list[float]) -> Floats:
    transform = np.eye(4)
    transform[:3, :3] = _rotations(np.array([rotation]))[0]
    transform[:3, 3] = translation
    return transform


def test_the_pose_of_the_base_is_level_at_the_start(to_ros: Any) -> None:
    """A camera that looks forward and drives 2 m forward: the base moves along its x axis."""
    link_from_optical = np.array([[0.0, 0, 1, 0.3], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])
    world_from_cam0 = np.eye(4)
    world_from_cam0[:3, 3] = [0.0, 0.0, 2.0]
    pose, _ = to_ros(world_from_cam0, np.eye(6), link_from_optical)
    expected = np.eye(4)
    expected[0, 3] = 2.0
    np.testing.assert_allclose(pose, expected, atol=1e-12)


def test_the_covariance_is_that_of_disturbed_poses(to_ros: Any) -> None:
    random = np.random.default_rng(4)
    root = random.normal(size=(6, 6)) * 0.003
    covariance = root @ root.T
    world_from_cam0 = _transform([0.3, -0.8, 0.4], [4.0, -1.0, 7.0])
    base_from_cam0 = _transform([1.2, -1.2, 1.2], [0.3, 0.1, 0.5])
    pose, converted = to_ros(world_from_cam0, covariance, base_from_cam0)

    xi = random.normal(size=(SAMPLES, 6)) @ root.T
    disturbed = np.tile(np.eye(4), (SAMPLES, 1, 1))
    disturbed[:, :3, :3], disturbed[:, :3, 3] = _rotations(xi[:, :3]), xi[:, 3:]
    true = base_from_cam0 @ world_from_cam0 @ disturbed @ np.linalg.inv(base_from_cam0)
    shift = true[:, :3, 3] - pose[:3, 3]
    turn = true[:, :3, :3] @ pose[:3, :3].T  # about the axes of odom
    angles = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
    sampled = np.cov(np.hstack([shift, angles]).T)
    np.testing.assert_allclose(converted, sampled, atol=0.02 * np.abs(converted).max())


def test_optical_frames_are_turned_as_the_page_says() -> None:
    x, y, z, w = -0.5, 0.5, -0.5, 0.5
    vector = np.array([x, y, z])
    forward = np.array([0.0, 0.0, 1.0])
    cross = np.cross(vector, forward)
    turned = forward + 2.0 * (w * cross + np.cross(vector, cross))
    np.testing.assert_allclose(turned, [1.0, 0.0, 0.0], atol=1e-12)
