"""Records of calibration errors: as a window shows them, and as they are corrected."""

from __future__ import annotations

from typing import NamedTuple

from vo.base.types import Floats


class RightCameraError(NamedTuple):
    """Error of the right camera's calibration that was found and is corrected.

    Attributes:
        pitch_deg: upwards.
        yaw_deg: to the left.
        roll_deg: counter-clockwise, seen from behind.
        zoom_percent: of the focal length, positive if it is longer.
        rows_px: maximum vertical disparity of rectified images.
        bend_px, skew_px: of `VerticalDisparity`.
    """

    pitch_deg: float
    yaw_deg: float
    roll_deg: float
    zoom_percent: float
    rows_px: float
    bend_px: float = 0.0
    skew_px: float = 0.0

    @property
    def in_words(self) -> str:
        """The error for people, without negligible parts."""
        amounts = (
            (self.pitch_deg, "° pitch"),
            (self.yaw_deg, "° yaw"),
            (self.roll_deg, "° roll"),
            (self.zoom_percent, " % focal length"),
        )
        parts = [f"{amount:+.2f}{of_what}" for amount, of_what in amounts if abs(amount) >= 0.01]
        rows = [f"rows differ by up to {self.rows_px:.1f} px"] if self.rows_px else []
        return ", ".join(parts + rows)


class CameraPoseError(NamedTuple):
    """Error of the pose of a camera of a rig, relative to camera 0, that is corrected."""

    camera: int
    angle_deg: float
    distance_m: float

    @property
    def in_words(self) -> str:
        """The error for people."""
        return f"by {self.angle_deg:.2f}° and {100.0 * self.distance_m:.1f} cm"


class LensError(NamedTuple):
    """Error of a lens, or of both lenses of a pair, that was found and is corrected.

    Attributes:
        k1: error of its first radial coefficient, that of OpenCV's `radtan` model.
        edge_px: outward shift of points at the image's edges.
    """

    k1: float
    edge_px: float


class CalibrationResidual(NamedTuple):
    """Remaining error of a calibration, as a window of keyframes shows it.

    Attributes:
        value: in stereo (2,) pixels: the bias of all disparities, and that which grows with the
            square of the distance from the image centre on the right, at one focal length. In mono
            (1,) the error of the radial distortion: ideal points x, in focal lengths, should be at
            x (1 - value r^2).
        information: (2, 2) or (1, 1), the inverse of its covariance.
        bend: what such errors do not explain, estimated together with them. In mono points should
            be at x (1 - value r^2 - bend r^4), with another value; in stereo at x (1 - bend r^2) in
            both images.
        bend_sigma: its standard deviation.
    """

    value: Floats
    information: Floats
    bend: float = 0.0
    bend_sigma: float = float("inf")


class CalibrationErrors(NamedTuple):
    """Errors of a calibration that were found and are corrected.

    Attributes:
        disparity_offset_px: constant bias of disparities.
        disparity_curve_px: their bias at one focal length from the principal point, growing with
            the square.
        right_camera: None without an error.
        lens_error: None without an error.
        cameras: errors of the poses of the cameras of a rig.
    """

    disparity_offset_px: float
    disparity_curve_px: float
    right_camera: RightCameraError | None
    lens_error: LensError | None
    cameras: tuple[CameraPoseError, ...] = ()
