"""Records of the memory: stored keyframes, candidates and verified loops.

Poses are those of the rectified camera. A *segment* is a connected part of the path with a world of
its own, the *odometry frame*, in which the local map works; loops never change it. The pose graph
places stored keyframes in the *map frame*, common to all merged segments (REP 105 calls the
two frames `odom` and `map`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.frozen import frozen
from vo.base.types import Bytes, Descriptors, Floats, Floats32, Ints
from vo.engine.mapping.keyframe import FrameId

PATCH_PX = 13  # side of a stored patch, sampled at the pyramid level of its feature


class PlaceKey(NamedTuple):
    """Identity of a stored keyframe.

    Attributes:
        session: 0 for those of a loaded map's first recording, and so on; the run itself is last.
        keyframe: id among the keyframes of its session.
    """

    session: int
    keyframe: int


@frozen(eq=False)
class PlaceLandmarks:
    """Landmarks as a keyframe observes them; rows belong together.

    Coordinates are relative to the keyframe, so that they move with it.

    Attributes:
        id: (n,) increasing, unique within the session.
        xyz: (n, 3) float32 in the camera's frame, unit of the segment.
        xy: (n, 2) float32 ideal pixels where it is observed.
        sigma: (n,) float32 standard deviation of the depth relative to the depth.
        descriptor: (n, width).
        octave: (n,) pyramid level.
        angle: (n,) float32 radians.
        patch: (n, PATCH_PX, PATCH_PX) uint8 around the observation, at its pyramid level.
    """

    id: Ints
    xyz: Floats32
    xy: Floats32
    sigma: Floats32
    descriptor: Descriptors
    octave: NDArray[np.int32]
    angle: Floats32
    patch: Bytes


@frozen(eq=False)
class PathKeyframe:
    """A keyframe of the path, when it is removed from the local map.

    Attributes:
        is_metric: whether lengths are metres (stereo, depth); otherwise units of the segment.
        odom_from_cam: (4, 4) in the odometry frame of its segment.
        covariance: (6, 6) of the motion since the keyframe before it in the segment,
            in this camera's frame (rotation, then translation, as GTSAM orders them).
        is_doubted: whether that motion may be wrong by more than its covariance says.
    """

    key: PlaceKey
    frame: FrameId
    is_metric: bool
    odom_from_cam: Floats
    covariance: Floats
    is_doubted: bool = field(default=False, kw_only=True)


@frozen(eq=False)
class Place(PathKeyframe):
    """A keyframe with what it shows, as it is stored.

    Attributes:
        descriptor: (N, width) of all its features, for place recognition.
        thumbnail: (h, w) uint8, the image at a height of at most 120 pixels, to compare places.
    """

    descriptor: Descriptors
    landmarks: PlaceLandmarks
    thumbnail: Bytes


class InertialPose(NamedTuple):
    """Pose of a keyframe of one camera by images and an inertial sensor.

    Attributes:
        world: number of the first segment of the world: segments may be joined without images.
        world_from_cam: (4, 4) in metres, in a world whose vertical is known.
        scale: metres of one unit of the keyframe's own segment.
    """

    world: int
    world_from_cam: Floats
    scale: float


class MarkerVisit(NamedTuple):
    """Where a marker is relative to a stored keyframe, by the keyframes of one visit.

    Attributes:
        key: of the first keyframe of the visit, or of one near it.
        length_m: side of its black square.
        cam_from_marker: (4, 4) similarity from metres in the frame of the marker to the frame of
            the keyframe, in the unit of its segment; rigid if that is metric.
        covariance: (7, 7) of its tangent in the frame of the marker, in metres; the last row and
            column are 0 if the segment is metric.
        keyframes: number of those that show the marker.
    """

    key: PlaceKey
    id: int
    dictionary: str
    length_m: float
    cam_from_marker: Floats
    covariance: Floats
    keyframes: int


class Candidate(NamedTuple):
    """A stored keyframe that may show the place of a query.

    Attributes:
        score: similarity of the bags of words, relative to that of consecutive keyframes.
    """

    key: PlaceKey
    score: float


@frozen(eq=False)
class Loop:
    """A verified relation between two stored keyframes.

    Attributes:
        earlier: keyframe that was stored before.
        later: keyframe that sees the same place again.
        earlier_from_later: (4, 4), translation in the unit of the earlier one's segment.
        scale: length in the unit of the earlier segment of one unit of the later one; 1 if both
            are metric.
        covariance: (7, 7) of rotation, translation and logarithm of the scale, in the later
            camera's frame; the last row and column are 0 if both are metric.
        inliers: landmarks that agree; of a marker, keyframes that agree.
        marker: id of the marker by which both are related, None if it is the look of the place.
    """

    earlier: PlaceKey
    later: PlaceKey
    earlier_from_later: Floats
    scale: float
    covariance: Floats
    inliers: int
    marker: int | None = None

    @property
    def support(self) -> int:
        """Keyframes whose views of their own it rests on."""
        return 1 if self.marker is None else self.inliers


@frozen(eq=False)
class RegisteredKeyframes:
    """Where the pose graph places keyframes; rows belong together.

    Attributes:
        world: (n,) number of the connected world that each belongs to: that of its first segment.
        world_from_cam: (n, 4, 4), in the unit of the world's first segment.
        scale: (n,) length in that unit of one unit of the keyframe's own segment.
        covariance: (n, 6, 6) in the camera's frame, NaN if unknown.
        rejected: loops that the graph takes for false.
        wrong: keyframes whose motion since the one before loops have shown to be wrong.
    """

    keys: tuple[PlaceKey, ...]
    world: Ints
    world_from_cam: Floats
    scale: Floats
    covariance: Floats
    rejected: tuple[Loop, ...]
    wrong: tuple[PlaceKey, ...] = ()

    def rows(self, rows: Ints | Sequence[int]) -> RegisteredKeyframes:
        """Those of some rows."""
        return RegisteredKeyframes(
            tuple(self.keys[n] for n in rows),
            self.world[rows],
            self.world_from_cam[rows],
            self.scale[rows],
            self.covariance[rows],
            self.rejected,
            self.wrong,
        )
