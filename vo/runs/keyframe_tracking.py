"""Keyframes of a recording and what they observe, for adjustments of its camera."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from typing import NamedTuple

import numpy as np

from vo.base.config import Config
from vo.base.types import Estimate, Floats, Frame, KeyframePose, Landmarks, Rig, Sightings
from vo.engine.backend.lens_adjustment import KeyframeViews
from vo.engine.odometry import Odometry

_MIN_VIEWS = 3  # of a landmark
_DENSE = {"min_parallax_mono_deg": 1.0, "max_gap_s": 0.2}


class TrackedKeyframes(NamedTuple):
    """A path and its keyframes by number of the frame, landmarks by their number."""

    path: list[Estimate]  # frames with a pose
    poses: dict[int, KeyframePose]
    sightings: dict[int, Sightings]
    points: dict[int, Floats]

    def add(self, estimate: Estimate, landmarks: Landmarks | None) -> None:
        """The keyframes that a frame has added or moved, with the map after it."""
        if estimate.world_from_cam0 is not None:
            self.path.append(estimate)
        self.poses.update({each.frame_index: each for each in estimate.keyframes})
        if landmarks is not None:
            self.sightings.update({each.frame_index: each for each in landmarks.sightings})
            self.points.update(zip(landmarks.ids.tolist(), landmarks.xyz, strict=True))

    @property
    def segments(self) -> list[list[int]]:
        """The keyframes of each segment that observe something."""
        found: dict[int, list[int]] = {}
        for number in sorted(self.sightings):
            if number in self.poses:
                found.setdefault(self.poses[number].segment, []).append(number)
        return list(found.values())

    def views(self, rows: list[int], middle: Floats) -> KeyframeViews:
        """Observations of the landmarks that three of these keyframes observe."""
        sightings, points = self.sightings, self.points
        keyframe = np.repeat(np.arange(len(rows)), [len(sightings[n].ids) for n in rows])
        ids = np.concatenate([sightings[n].ids for n in rows])
        xy = np.concatenate([sightings[n].xy for n in rows]).astype(np.float64)
        known, point, seen = np.unique(ids, return_inverse=True, return_counts=True)
        kept = (seen >= _MIN_VIEWS)[point] & np.array([n in points for n in known.tolist()])[point]
        used, point = np.unique(ids[kept], return_inverse=True)
        return KeyframeViews(
            middle,
            np.stack([self.poses[n].world_from_cam0 for n in rows]),
            np.array([points[n] for n in used.tolist()]).reshape(-1, 3),
            keyframe[kept],
            point,
            xy[kept],
        )


def track_keyframes(rig: Rig, config: Config, frames: Iterable[Frame]) -> TrackedKeyframes:
    """Run the odometry over frames; landmarks and poses are those of their last windows."""
    found = TrackedKeyframes([], {}, {}, {})
    with closing(Odometry(rig, config)) as odometry:
        for estimate in odometry.track_all(iter(frames)):
            landmarks = odometry.snapshot().landmarks if estimate.keyframes else None
            found.add(estimate, landmarks)
    return found


def without_extras(config: Config) -> Config:
    """The settings without loops, maps, and corrections of the lens."""
    off = {"lens_correction": False}, {"loops": False, "map": "", "localize": False}
    return config.model_copy(
        update={
            "refinement": config.refinement.model_copy(update=off[0]),
            "memory": config.memory.model_copy(update=off[1]),
        }
    )


def with_more_keyframes(config: Config) -> Config:
    """The settings with more keyframes, as for what changes quickly or moves little."""
    return config.model_copy(update={"keyframes": config.keyframes.model_copy(update=_DENSE)})
