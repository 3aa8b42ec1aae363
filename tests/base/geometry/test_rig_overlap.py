"""What cameras of a rig see in common."""

from __future__ import annotations

import numpy as np
import pytest

from data_synth.cameras import load_rig
from vo.base.geometry.rig_overlap import DISTANCES_M, overlap_ratios, overlaps, sees
from vo.base.types import Camera, Rig

PINHOLE = Camera(400, 300, 200.0, 200.0, 199.5, 149.5)


def test_parallel_cameras_share_what_their_baseline_leaves() -> None:
    cam1_from_cam0 = np.eye(4)
    cam1_from_cam0[0, 3] = -0.5
    ratios = overlap_ratios(Rig(PINHOLE, PINHOLE, cam1_from_cam0))
    # At a depth z the images are shifted by 100 / z pixels of 400.
    near, far = ratios[0, 1, 0], ratios[0, 1, -1]
    assert near == pytest.approx(0.7, abs=0.06) and far == pytest.approx(0.99, abs=0.015)
    np.testing.assert_allclose(ratios[0, 1], ratios[1, 0], atol=1e-9)
    assert ratios.shape == (2, 2, len(DISTANCES_M))


def test_neighbours_of_the_car_overlap_and_no_others() -> None:
    found = {each[:2]: each for each in overlaps(load_rig("car"))}
    neighbours = {(0, 1), (0, 2), (1, 3), (2, 4), (3, 5), (4, 5)}
    assert neighbours <= set(found) <= neighbours | {(1, 2), (0, 3)}
    assert found[0, 1].ratio > 0.95 and found[0, 1].baseline_m == pytest.approx(0.5)
    assert 0.1 < found[2, 4].ratio < 0.4


def test_cameras_back_to_back_have_nothing_in_common() -> None:
    assert overlaps(load_rig("drone")) == ()


def test_a_camera_sees_what_is_in_its_image() -> None:
    points = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, -5.0], [5.2, 0.0, 5.0], [4.9, 0.0, 5.0]])
    assert sees(PINHOLE, np.eye(4), points).tolist() == [True, False, False, True]
