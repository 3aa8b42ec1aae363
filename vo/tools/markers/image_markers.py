"""Markers in an image, and their poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.base.types import Floats


@dataclass(frozen=True, eq=False)
class DetectedMarker:
    """A marker in an image.

    Attributes:
        corners: (4, 2) pixels of the recorded image: those that are top left, top right, bottom
            right and bottom left on the upright marker.
        sigma_px: standard deviation of each coordinate of a corner.
    """

    id: int
    corners: Floats
    sigma_px: float

    @property
    def side_px(self) -> float:
        """Mean length of its four sides in the image."""
        return float(np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=0), axis=1).mean())


@dataclass(frozen=True, eq=False)
class PlanePose:
    """Pose of a marker or board: x to its right, y up, z out of it, origin in its middle.

    Attributes:
        cam_from_marker: (4, 4), in metres.
        covariance: (6, 6) of the tangent (rx ry rz tx ty tz), rad and m, in the frame of the
            camera: true = exp(xi) @ cam_from_marker.
        error_px: RMS distance of the corners from where the pose predicts them.
        other: the second pose that a plane allows, None where there is none: its normal is mirrored
            at the line of sight.
        other_error_px: RMS distance for it, infinite without one.
        evidence: how much less likely the other pose is: difference of the squared errors of all
            corners, in standard deviations squared.
    """

    cam_from_marker: Floats
    covariance: Floats
    error_px: float
    other: Floats | None
    other_error_px: float
    evidence: float

    @property
    def distance_m(self) -> float:
        """From the camera to the origin of the marker."""
        return float(np.linalg.norm(self.cam_from_marker[:3, 3]))

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the position, all axes together."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def sigma_deg(self) -> float:
        """Standard deviation of the orientation, all axes together."""
        return float(np.rad2deg(np.sqrt(np.trace(self.covariance[:3, :3]))))

    @property
    def is_ambiguous(self) -> bool:
        """Whether the other pose explains the corners nearly as well."""
        return self.evidence < MIN_EVIDENCE


MIN_EVIDENCE = 25.0  # five standard deviations: corners of small markers have larger errors


@dataclass(frozen=True, eq=False)
class Marker:
    """A marker in an image and, with a calibration, its pose."""

    detected: DetectedMarker
    pose: PlanePose | None = None

    @property
    def id(self) -> int:
        """Its number in the dictionary."""
        return self.detected.id


@dataclass(frozen=True, eq=False)
class FrameMarkers:
    """What a frame shows.

    Attributes:
        frame_index: its number in the recording, 0 for an image.
        stamp_ns: its time, 0 for an image.
        board: pose of the board that they belong to, None without one.
    """

    frame_index: int
    stamp_ns: int
    markers: tuple[Marker, ...]
    board: PlanePose | None = None

    @property
    def repeated_ids(self) -> tuple[int, ...]:
        """Ids of which the frame shows several markers."""
        ids = [marker.id for marker in self.markers]
        return tuple(number for number in dict.fromkeys(ids) if ids.count(number) > 1)
