"""Keyframes and landmarks of a whole run, as they are now: on disk, and in the present map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.base.types import Bytes, Floats, Ints, Landmarks, Sightings
from vo.outputs.recorders.map_spool import LandmarkRows, MapSpool


@dataclass(frozen=True, eq=False)
class MapSource:
    """Observations and landmarks on disk, and those of the present map."""

    spool: MapSpool  # what has left the map
    landmarks: Landmarks
    rows: LandmarkRows
    poses: tuple[Ints, Floats]  # frames (K,) of all keyframes, and their poses (K, 4, 4)
    scales: Floats  # (K,) lengths in the world of one unit of the rows of their landmarks
    scale: float = 1.0  # factor of all lengths that are given out

    def world_from_cam0(self, frames: Ints) -> Floats:
        """Poses (N, 4, 4) of keyframes."""
        poses = self.poses[1][np.searchsorted(self.poses[0], frames)]
        poses[..., :3, 3] *= self.scale
        return np.asarray(poses)

    def observations(self, frame: int) -> tuple[Ints, Floats]:
        """Ids (N,), increasing, and pixels (N, 2) of a keyframe."""
        in_map: Sightings | None = next(
            (each for each in self.landmarks.sightings if each.frame_index == frame), None
        )
        ids, xy = self.spool.observations(frame) if in_map is None else (in_map.ids, in_map.xy)
        order = np.argsort(ids, kind="stable")
        return ids[order], xy[order]

    def points(self, ids: Ints) -> tuple[Floats, Bytes]:
        """Points (N, 3) in the world, NaN where unknown, and grey levels (N,); increasing ids."""
        rows = self.spool.landmarks(ids)
        place = np.searchsorted(self.landmarks.ids, ids)
        place = np.minimum(place, max(len(self.landmarks.ids) - 1, 0))
        if len(self.landmarks.ids):
            in_map = self.landmarks.ids[place] == ids
            rows[in_map] = self.rows[place[in_map]]
        xyz = np.full((len(ids), 3), np.nan)
        known = rows["is_known"]
        frames = rows["keyframe"][known].astype(np.int64)
        scales = self.scale * self.scales[np.searchsorted(self.poses[0], frames)]
        in_keyframe = scales[:, None] * rows["in_keyframe"][known]
        xyz[known] = transformed(self.world_from_cam0(frames), in_keyframe)
        return xyz, rows["grey"].copy()


def transformed(a_from_b: Floats, points: Floats) -> Floats:
    """Points (N, 3), each moved by its own transform (N, 4, 4)."""
    rotated = np.einsum("nij,nj->ni", a_from_b[:, :3, :3], points)
    return np.asarray(rotated + a_from_b[:, :3, 3])
