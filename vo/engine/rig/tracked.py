"""What tracking finds in the views of a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vo.base.types import Floats
from vo.engine.mapping.tracked_frame import LastFrame, Observations, TrackedFrame, last_frame
from vo.engine.rig.frames import RigFrame

_MIN_LANDMARKS = 150  # aligned in each view


def landmarks_per_view(total: int, views: int) -> int:
    """Maximum number of landmarks aligned in a view, for about as many in all of them."""
    return max(_MIN_LANDMARKS, total // views)


@dataclass(frozen=True, eq=False)
class RigTracked:
    """A frame with the pose of the body, and with each view as a tracked frame.

    Attributes:
        world_from_body: (4, 4).
        body_from_views: (V, 4, 4) at the times of the images.
        views: of all views, without observations where one is not used.
    """

    world_from_body: Floats
    body_from_views: Floats
    views: tuple[TrackedFrame, ...]

    @property
    def inliers(self) -> int:
        """Number of observations that agree with the pose."""
        return sum(view.inliers for view in self.views)

    @property
    def in_view(self) -> int:
        """Number of landmarks that should be in the views, each counted in all of them."""
        return sum(view.in_view for view in self.views)

    @property
    def inlier_ratio(self) -> float:
        """Inliers among the landmarks that should be in the views."""
        return self.inliers / max(self.in_view, 1)

    @property
    def body(self) -> TrackedFrame:
        """View 0, with the pose of the body."""
        return replace(self.views[0], world_from_cam=self.world_from_body)


@dataclass(frozen=True, eq=False)
class LastRigFrame:
    """The last tracked frame."""

    frame: RigFrame
    tracked: RigTracked

    def in_view(self, view: int) -> LastFrame:
        """One view alone."""
        return last_frame(self.frame.views[view], self.tracked.views[view])


def unobserved() -> Observations:
    """Observations of nothing."""
    pixels, none = np.empty((0, 2)), np.empty(0)
    return Observations(np.empty(0, np.int64), pixels, pixels, none, none, none, none, pixels)
