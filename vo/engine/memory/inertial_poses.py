"""What the memory calls of an inertial sensor of a single camera."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from vo.engine.inertial_path.placement import InertialPlacement
from vo.engine.places.records import InertialPose


class InertialPoses(Protocol):
    """Gives the pose graph metric poses, and applies its results in metres."""

    @property
    def placement(self) -> InertialPlacement:
        """Applies results of the pose graph."""
        ...

    def graph_poses(self) -> Mapping[int, InertialPose]:
        """Poses by id of the keyframe for the graph that is optimised next."""
        ...
