"""The records that rooms hand to each other.

Conventions, everywhere: a transform `a_from_b` takes coordinates in frame b to frame a and is a
(4, 4) float64 array; frames are `world`, `cam0`, `cam1` (x right, y down, z forward); pixels are
(u, v) with the centre of the top-left pixel at (0, 0); lengths in metres (mono: in units of the
map), angles in radians, time in integer nanoseconds; points are rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field
from enum import StrEnum
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.failures import Failure
from vo.base.faults import Fault
from vo.base.frozen import frozen

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]
Descriptors = NDArray[np.generic]  # (N, width), of the type that the feature extractor gives

DistortionModel = Literal[
    "none",
    "radtan",
    "equidistant",
    "double_sphere",
    "extended_unified",
    "omni",
    "equirectangular",
]
Mode = Literal["auto", "mono", "stereo"]


@frozen()
class Camera:
    """A camera: how directions fall onto a plane, and where the pixels lie on it.

    Attributes:
        width, height: size of the image in pixels.
        fx, fy: focal length in pixels, along u and v; pixels per unit of the plane.
        cx, cy: principal point.
        distortion_model: `radtan` (OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]), `equidistant`
            (Kannala-Brandt, k1..k4, OpenCV's fisheye), `double_sphere` (xi alpha),
            `extended_unified` (alpha beta), `omni` (Mei's xi, then those of radtan),
            `equirectangular` (longitude and latitude, 2 pi fx pixels around) or `none`.
        distortion: its coefficients.
        readout_s: time from the first to the last row of an image; 0 for a global shutter.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion_model: DistortionModel = "none"
    distortion: tuple[float, ...] = ()
    readout_s: float = 0.0

    @property
    def matrix(self) -> Floats:
        """The (3, 3) matrix K of the ideal pinhole camera."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def is_distorted(self) -> bool:
        """Whether pixels differ from those of the ideal pinhole camera."""
        return self.distortion_model not in ("none", "radtan") or any(self.distortion)


class MountedCamera(NamedTuple):
    """A camera of a rig, and the transform (4, 4) from it to camera 0."""

    camera: Camera
    cam0_from_cam: Floats


@frozen(eq=False)
class Rig:
    """Cameras that are fixed to each other: one, with depth or without, a pair, or more.

    Attributes:
        further: cameras 2, 3, and so on, of more than a pair.
        is_exchanged: whether both of a pair have changed places; poses are those of cam1 then.
    """

    cam0: Camera
    cam1: Camera | None = None
    cam1_from_cam0: Floats | None = None
    has_depth: bool = False
    further: tuple[MountedCamera, ...] = ()
    is_exchanged: bool = False

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras by index."""
        pair = (self.cam0,) if self.cam1 is None else (self.cam0, self.cam1)
        return pair + tuple(each.camera for each in self.further)

    @property
    def cam0_from_cams(self) -> Floats:
        """(n, 4, 4) from each camera to camera 0."""
        poses: list[Floats] = [np.eye(4)]
        if self.cam1_from_cam0 is not None:
            poses.append(np.asarray(np.linalg.inv(self.cam1_from_cam0)))
        return np.stack(poses + [each.cam0_from_cam for each in self.further])

    def first(self, count: int) -> Rig:
        """The rig of its first cameras only, without depth if there were more than those."""
        if count >= len(self.cameras):
            return self
        if count == 1:
            return Rig(self.cam0)
        return Rig(self.cam0, self.cam1, self.cam1_from_cam0, further=self.further[: count - 2])

    def exchanged(self) -> Rig:
        """The same pair, which is tracked by its other camera."""
        assert self.cam1 is not None and self.cam1_from_cam0 is not None and not self.further
        cam0_from_cam1 = np.asarray(np.linalg.inv(self.cam1_from_cam0))
        return Rig(self.cam1, self.cam0, cam0_from_cam1, is_exchanged=not self.is_exchanged)

    @property
    def is_stereo(self) -> bool:
        """Whether there are two cameras or more."""
        return len(self.cameras) > 1

    @property
    def is_metric(self) -> bool:
        """Whether lengths come out in metres."""
        return self.is_stereo or self.has_depth


@frozen(eq=False)
class Frame:
    """Images of all cameras at one time.

    Attributes:
        index: number of the frame in its source, from 0, counting skipped frames too.
        stamp_ns: time of the image of camera 0 in nanoseconds; where a rig has none, the time it
            should have.
        images: (H, W) uint8 grey by camera, as recorded (distorted, unrectified), None where one is
            missing; in colour or with 16 bits only if `FrameStream.frames` was asked for that.
        depth: (H, W) float32 metres along the axis of camera 0, 0 where unknown; None without.
        path: the file with the image of camera 0 as recorded, perhaps in colour; None without one.
        mask: (H, W) uint8, 0 where the image of camera 0 is not used, 255 elsewhere; or None.
        stamps_ns: times of the images by camera, where a rig has no common trigger; or None.
    """

    index: int
    stamp_ns: int
    images: tuple[Bytes | None, ...]
    depth: Floats32 | None = None
    path: Path | None = None
    mask: Bytes | None = None
    stamps_ns: tuple[int, ...] | None = None

    @property
    def image0(self) -> Bytes:
        """The image of camera 0, which only frames of a rig may lack; see `with_image0`."""
        image = self.images[0]
        assert image is not None
        return image

    @property
    def image1(self) -> Bytes | None:
        """The image of camera 1, None where it is missing and with a single camera."""
        return self.images[1] if len(self.images) > 1 else None


def with_image0(frames: Iterable[Frame]) -> Iterator[Frame]:
    """Those frames that have an image of camera 0; of a rig, others may have a few without."""
    return (frame for frame in frames if frame.images[0] is not None)


@frozen()
class Skipped:
    """A frame that a source could not hand out, and why."""

    index: int
    stamp_ns: int
    reason: str


@frozen(eq=False)
class Trajectory:
    """Poses in time.

    Attributes:
        stamps_ns: (N,) int64, increasing.
        world_from_cam: (N, 4, 4) float64.
    """

    stamps_ns: Ints
    world_from_cam: Floats

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def positions(self) -> Floats:
        """(N, 3) camera centres in the world."""
        return np.asarray(self.world_from_cam[:, :3, 3], dtype=np.float64)


@frozen()
class ImuNoise:
    """Continuous-time noise of an inertial sensor, as Kalibr and EuRoC give it.

    Attributes:
        gyro_noise: rad/s/√Hz.
        gyro_walk: rad/s²/√Hz.
        accel_noise: m/s²/√Hz.
        accel_walk: m/s³/√Hz.
    """

    gyro_noise: float
    gyro_walk: float
    accel_noise: float
    accel_walk: float


@frozen(eq=False)
class Keypoints:
    """Image features as a struct of arrays; row i of each belongs together.

    Attributes:
        xy: (N, 2) float32 pixels at full resolution.
        octave: (N,) int32 pyramid level.
        angle: (N,) float32 orientation in radians, NaN where the extractor gives none.
        response: (N,) float32 corner strength, comparable within one image.
        descriptor: (N, width) of the extractor's layout; of ORB 32 uint8, 256 bits.
    """

    xy: Floats32
    octave: NDArray[np.int32]
    angle: Floats32
    response: Floats32
    descriptor: Descriptors

    def __len__(self) -> int:
        return len(self.xy)

    def select(self, rows: Bools | Ints) -> Keypoints:
        """Some rows of the keypoints."""
        at = rows.nonzero()[0] if rows.dtype == np.bool_ else rows
        xy, descriptor = self.xy.take(at, axis=0), self.descriptor.take(at, axis=0)
        return Keypoints(
            xy, self.octave.take(at), self.angle.take(at), self.response.take(at), descriptor
        )


class State(StrEnum):
    """What the odometry is doing."""

    STARTING = "starting"
    TRACKING = "tracking"
    LOST = "lost"

    @property
    def has_pose(self) -> bool:
        """Whether frames in this state have a pose."""
        return self is State.TRACKING


@frozen(eq=False)
class KeyframePose:
    """The optimised pose of a keyframe.

    Attributes:
        frame_index: number of its frame in the source.
        stamp_ns: its time.
        segment: number of its segment, from 0.
        world_from_cam0: (4, 4).
        covariance: (6, 6) of the tangent (rx ry rz tx ty tz), rad and m, in the cam0 frame:
            true = world_from_cam0 @ exp(xi); None before the first optimisation.
        scale: length in the world of one unit of the map that it was tracked in.
    """

    frame_index: int
    stamp_ns: int
    segment: int
    world_from_cam0: Floats
    covariance: Floats | None
    scale: float = 1.0


@frozen(eq=False)
class Sightings:
    """Of a keyframe: the `ids` of landmarks (n,), and their pixels `xy` (n, 2) in its image0."""

    frame_index: int
    ids: Ints
    xy: Floats


@frozen(eq=False)
class Landmarks:
    """Points of the map; row i of each belongs together.

    Attributes:
        ids: (M,).
        xyz: (M, 3) in the world.
        grey: (M,) grey level at the centre of the reference patch.
        sigma: (M,) standard deviation of the position, all axes together, given exact poses.
        sightings: of all keyframes in the map, in time order.
    """

    ids: Ints
    xyz: Floats
    grey: Bytes | None = None
    sigma: Floats | None = None
    sightings: tuple[Sightings, ...] = ()


class PredictedPose(NamedTuple):
    """Pose of a lost frame, or of any time (`Odometry.predict`), which no image confirms.

    Attributes:
        world_from_cam0: (4, 4) in the world of the tracked frame before it.
        covariance: (6, 6) as that of `KeyframePose`: of the newest keyframe that has one, and of
            the motion since the last tracked frame by the sensor, which grows; None if unknown.
    """

    world_from_cam0: Floats
    covariance: Floats | None


@frozen(eq=False)
class Estimate:
    """Result of one frame.

    Attributes:
        frame_index, stamp_ns: number of the frame in its source, and its time.
        state: `tracking` exactly where there is a pose `world_from_cam0`.
        failure: why it was not tracked, None where it was.
        segment: number of the segment, from 0; a new one begins after each loss.
        world_from_cam0: (4, 4) pose as known now (causal), None where it was not tracked.
        is_keyframe: whether the frame became a keyframe.
        features: landmarks found in the frame, and other features that were extracted.
        matches: landmarks found in the frame.
        inliers: those that agree with the pose.
        keyframes: keyframes that were added or moved in this step.
        landmark_ids: (M,) of the local map, where keyframes were added or moved, else None.
        stage_ms: wall time by stage in milliseconds.
        disparity_offset_px: bias of disparities that is corrected now.
        median_disparity_px: median over the inliers, None without disparities.
        faults: faults of the recording that were found in the frame.
        tracked_anew_from: number of the first frame that was tracked anew by this one, or None.
        dropped: images of a live source that were left out so far.
        predicted: of a lost frame, by an inertial sensor whose states are known, else None.
    """

    frame_index: int
    stamp_ns: int
    state: State
    failure: Failure | None
    segment: int
    world_from_cam0: Floats | None
    is_keyframe: bool
    features: int
    matches: int
    inliers: int
    keyframes: tuple[KeyframePose, ...]
    landmark_ids: Ints | None = None
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    disparity_offset_px: float = 0.0
    median_disparity_px: float | None = None
    faults: tuple[Fault, ...] = ()
    tracked_anew_from: int | None = None
    dropped: int = 0
    predicted: PredictedPose | None = None

    def __repr__(self) -> str:
        what = f"frame {self.frame_index}, {self.stamp_ns} ns: {self.state.value}"
        if self.position is None:
            return f"<vo.Estimate {what}, no pose: {self.failure}>"
        place = ", ".join(f"{each:.4g}" for each in self.position)
        agree = f"{self.inliers} of {self.matches} matches agree, segment {self.segment}"
        return f"<vo.Estimate {what} at ({place}),\n  {agree}{', keyframe' * self.is_keyframe}>"

    @property
    def position(self) -> Floats | None:
        """(3,) centre of cam0 in the world, None where there is no pose."""
        return None if self.world_from_cam0 is None else self.world_from_cam0[:3, 3]

    @property
    def causal_pose(self) -> Floats | None:
        """(4, 4) world_from_cam0 as tracked, else as predicted; None without either."""
        if self.world_from_cam0 is not None or self.predicted is None:
            return self.world_from_cam0
        return self.predicted.world_from_cam0
