"""Rigid bodies of markers, such as cubes, whose pose uses all their markers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.types import Bytes, Camera
from vo.engine.markers.marker_problem import square_points
from vo.tools.markers.image_markers import DetectedMarker, PlanePose
from vo.tools.markers.marker_map import MarkerMap
from vo.tools.markers.plane_pose import plane_pose, pose_from


class MarkerBody(NamedTuple):
    """A rigid body of markers, such as a cube; its frame is that of its file."""

    markers: MarkerMap

    def pose(
        self, camera: Camera, image: Bytes, markers: Sequence[DetectedMarker]
    ) -> PlanePose | None:
        """See `MarkerBoard`."""
        known = self.markers.markers
        seen = [marker for marker in markers if marker.id in known]
        points, pixels, guesses = [], [], []
        for marker in seen:
            square = square_points(known[marker.id].length_m)
            body_from_marker = known[marker.id].map_from_marker
            points.append(square @ body_from_marker[:3, :3].T + body_from_marker[:3, 3])
            pixels.append(marker.corners)
            single = plane_pose(camera, square, marker.corners, marker.sigma_px)
            if single is not None:
                poses = (single.cam_from_marker, single.other)
                back = inverse(body_from_marker)
                guesses += [np.asarray(pose @ back) for pose in poses if pose is not None]
        if not guesses:
            return None
        sigma = float(np.sqrt(np.mean([marker.sigma_px**2 for marker in seen])))
        return pose_from(camera, np.concatenate(points), np.concatenate(pixels), sigma, guesses)
