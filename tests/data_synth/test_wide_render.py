"""Lenses that see behind them, against pinhole cameras that look there."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from data_synth.cameras import load_rig
from data_synth.scene.render import camera_rays, render
from data_synth.scene.shutter import Shutter, static_shutter
from data_synth.scene.wide_render import faces_of, render_faces, sees_behind
from data_synth.worlds.registry import make_scene
from vo.base.geometry.rectification_maps import wide_maps
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Camera, Floats

PINHOLE = Camera(161, 161, 120.0, 120.0, 80.0, 80.0)


@pytest.mark.parametrize(
    ("lens", "yaw_deg"),
    [("fisheye190", 0), ("fisheye190", 40), ("panorama", 30), ("panorama", 180)],
)
def test_a_part_of_the_image_is_what_a_pinhole_camera_there_sees(lens: str, yaw_deg: float) -> None:
    camera = load_rig(lens).cam0
    world = make_scene("room", 1, 0.0, 0).world
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    pose = make_transform(level, np.array([0.0, 0.0, 1.4]))
    turn = make_transform(so3_exp(np.array([0.0, np.deg2rad(yaw_deg), 0.0])), np.zeros(3))

    def shutter_at(cam_from_face: Floats) -> Shutter:
        return static_shutter(pose @ cam_from_face)

    with ThreadPoolExecutor(2) as pool:
        whole = render_faces(world, faces_of(camera), shutter_at, pool).image
        expected = render(world, camera_rays(PINHOLE), shutter_at(turn), pool).image
    maps = wide_maps(camera, turn[:3, :3].T, PINHOLE.matrix, (161, 161))
    part = cv2.remap(whole, *maps, cv2.INTER_LINEAR)
    blurred = [cv2.GaussianBlur(image, (0, 0), 2.0) for image in (part, expected)]
    assert expected.std() > 0.05
    assert np.abs(blurred[0] - blurred[1]).mean() < 0.06 * expected.std()
    moved, _ = cv2.phaseCorrelate(*[image.astype(np.float64) for image in blurred])
    assert np.abs(moved).max() < 0.1


@pytest.mark.parametrize(
    ("name", "expected"),
    [("euroc", False), ("fisheye", False), ("fisheye190", True), ("panorama", True)],
)
def test_only_lenses_beyond_180_degrees_need_faces(name: str, expected: bool) -> None:
    assert sees_behind(load_rig(name).cam0) is expected
