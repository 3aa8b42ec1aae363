"""Noise-free images of a board from a known camera."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from vo.base.geometry.cameras import normalise
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Bytes, Camera, Floats, Floats32
from vo.tools.calibrating.board import Board

_PER_SQUARE = 48
_OVERSAMPLING = 3
BACKGROUND = 110


@lru_cache(maxsize=8)
def texture_of(board: Board) -> Bytes:
    """The board with a white margin of one square, `_PER_SQUARE` pixels per square."""
    size = ((board.columns + 1) * _PER_SQUARE, (board.rows + 1) * _PER_SQUARE)
    if board.kind == "charuco":
        squares = board.charuco().generateImage(size, marginSize=0)
    else:
        row, column = np.indices((size[1], size[0])) // _PER_SQUARE
        squares = np.where((row + column) % 2 == 0, 0, 255).astype(np.uint8)
    return np.pad(squares, _PER_SQUARE, constant_values=255)


@lru_cache(maxsize=8)
def _rays(camera: Camera) -> Floats32:
    """(H n, W n, 2) normalised coordinates of the centres of n x n subpixels."""
    u = (np.arange(camera.width * _OVERSAMPLING) + 0.5) / _OVERSAMPLING - 0.5
    v = (np.arange(camera.height * _OVERSAMPLING) + 0.5) / _OVERSAMPLING - 0.5
    pixels = np.stack(np.meshgrid(u, v), axis=2)
    return normalise(camera, pixels.reshape(-1, 2)).reshape(pixels.shape).astype(np.float32)


def render(board: Board, camera: Camera, cam_from_board: Floats) -> Bytes:
    """Antialiased image (H, W) of a board in front of the camera."""
    # Centres of texture pixels are at integer coordinates.
    squares = _PER_SQUARE / board.square_m
    texture_from_board = np.array(
        [[squares, 0, _PER_SQUARE - 0.5], [0, squares, _PER_SQUARE - 0.5], [0, 0, 1]]
    )
    board_from_ray = np.linalg.inv(cam_from_board[:3, [0, 1, 3]])
    place = cv2.perspectiveTransform(_rays(camera), texture_from_board @ board_from_ray)
    place = np.clip(np.nan_to_num(place, nan=-1e4), -1e4, 1e4)
    fine = cv2.remap(texture_of(board), place, None, cv2.INTER_LINEAR, borderValue=BACKGROUND)
    image = cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    # Limited contrast and slight blur, as with a real lens.
    soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.6)
    return np.round(30.0 + 0.75 * soft).astype(np.uint8)


def poses_around(board: Board, camera: Camera, count: int, tilt_deg: float = 35.0) -> list[Floats]:
    """Poses of the board (cam_from_board): all over the image, near and far, tilted."""
    rng = np.random.default_rng(5)
    middle = np.array([(board.columns + 1) / 2, (board.rows + 1) / 2, 0.0]) * board.square_m
    width_m = (board.columns + 1) * board.square_m
    poses = []
    for number in range(count):
        # Distant boards farther off the centre; a chessboard must be completely visible.
        reach = 0.5 if number % 2 else (0.62 if board.kind == "chessboard" else 0.8)
        place = (np.array([number % 4 / 3, number // 4 % 3 / 2]) - 0.5) * reach + 0.5
        pixel = place * (camera.width - 1, camera.height - 1)
        ray = np.append(normalise(camera, pixel[None])[0], 1.0)
        ray /= np.linalg.norm(ray)
        facing = so3_exp(np.cross([0.0, 0.0, 1.0], ray))
        turn = facing @ so3_exp(np.deg2rad(rng.uniform(-tilt_deg, tilt_deg, 3)))
        centre = (
            ray
            * width_m
            * camera.fx
            / camera.width
            * (rng.uniform(2.0, 2.6) if number % 2 else rng.uniform(3.0, 3.6))
        )
        poses.append(make_transform(turn, centre - turn @ middle))
    return poses
