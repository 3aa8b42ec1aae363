"""Frames between two keyframes, which share what the second one was moved by."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo.base.geometry.transforms import skew, whole_transforms
from vo.base.types import Floats, Ints


def share_motion(
    poses: Floats, frames: NDArray[Any], rows: Ints, keyframes: NDArray[Any], name: str
) -> None:
    """Move frames towards the next keyframe by what that one was moved by since it was tracked.

    What a frame measures is relative to the keyframe before it, with an error that grows until the
    next one. The rotation and the shift of the latter are shared in proportion to the time.

    Args:
        poses: (n, 4, 4) of the frames, to be changed in place.
        frames: (n,) of the table of frames.
        rows: (n,) of their keyframes.
        keyframes: (K,) the table of keyframes.
        name: of the poses of keyframes in the table.
    """
    part = keyframes[rows[0] : rows[-1] + 2]
    tracked = whole_transforms(part["previous_from_cam"][1:])
    if name == "world_from_cam0":
        tracked[:, :3, 3] *= part["scale"][:-1, None]
    interval = rows - rows[0]
    is_known = np.append(np.isfinite(tracked[:, 0, 0]), False)
    chosen = np.flatnonzero(is_known[interval] & (frames["fraction"] == 0))
    if len(chosen) == 0:
        return
    pose = whole_transforms(part[name])
    reached, placed = pose[:-1] @ tracked, pose[1:]
    turn = _rotation_vectors(placed[:, :3, :3] @ np.swapaxes(reached[:, :3, :3], 1, 2))
    shift = placed[:, :3, 3] - reached[:, :3, 3]
    interval = interval[chosen]
    begin, duration = part["stamp_ns"][interval], np.diff(part["stamp_ns"])[interval]
    share = ((frames["stamp_ns"][chosen] - begin) / np.maximum(duration, 1))[:, None]
    poses[chosen, :3, :3] = _rotations(share * turn[interval]) @ poses[chosen, :3, :3]
    poses[chosen, :3, 3] += share * shift[interval]


def _rotation_vectors(rotations: Floats) -> Floats:
    """(n, 3) of rotations (n, 3, 3) by less than pi."""
    odd = 0.5 * (rotations - np.swapaxes(rotations, 1, 2))
    vector = np.stack([odd[:, 2, 1], odd[:, 0, 2], odd[:, 1, 0]], axis=1)
    sine = np.linalg.norm(vector, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0))
    return np.asarray(vector * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)[:, None])


def _rotations(vectors: Floats) -> Floats:
    """(n, 3, 3) of rotation vectors (n, 3), by Rodrigues' formula."""
    angle, k = np.linalg.norm(vectors, axis=1)[:, None, None], skew(vectors)
    # sinc(x) is sin(pi x) / (pi x).
    half = np.sinc(angle / (2.0 * np.pi))
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * half**2 * (k @ k))
