"""Online calibration: corrections of the cameras from the residuals of many windows."""

from __future__ import annotations

from typing import NamedTuple

from vo.base.config import RefinementConfig
from vo.base.faults import Fault
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.base.records.calibration_errors import CalibrationResidual
from vo.engine.refinement.disparity_bias import DisparityBiasEstimator, is_from_yaw
from vo.engine.refinement.radial_distortion import RadialDistortionEstimator

# Consecutive windows share most of their keyframes: after the first windows of a run only every
# third one is evaluated, with the weight of three.
_EVALUATE_ALL, _EVALUATE_EVERY = 10, 3
_OVERLAP = 10  # number of consecutive windows that share keyframes


class DisparityCorrection(NamedTuple):
    """Bias of all disparities, to be subtracted.

    Attributes:
        curve_px: at one focal length from the principal point, growing with the square.
        is_yaw: whether the cause is a yaw of the right camera.
    """

    offset_px: float
    curve_px: float
    is_yaw: bool


class RadialDistortionCorrection(NamedTuple):
    """Error of a lens.

    Attributes:
        k1: to be added to its first radial coefficient.
    """

    k1: float


Correction = DisparityCorrection | RadialDistortionCorrection


class CalibrationRefiner:
    """Estimates corrections: of the disparity bias in stereo, of the lens in mono.

    Args:
        has_depth: whether disparities are those of a depth camera, which has other errors.
    """

    def __init__(self, rig: RectifiedRig, config: RefinementConfig, *, has_depth: bool) -> None:
        self._rig = rig
        self._estimator = _estimator(rig)
        if rig.is_metric:
            self._is_enabled = config.disparity_correction and not has_depth
        else:
            self._is_enabled = config.lens_correction
        self._submitted = 0  # windows
        self._resume = 0  # number of the first window that is evaluated after a suspension

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Errors that are known now and cannot be corrected."""
        return self._estimator.faults

    def restart(self) -> None:
        """Forget all windows: what they observed was no rigid scene."""
        self._estimator = _estimator(self._rig)

    def suspend(self) -> None:
        """Evaluate no window with any of the newest keyframes.

        To be called at each frame whose observations are not those of a rigid scene, such as things
        that are fixed in the image. Corrections that were found before stay as they are.
        """
        self._resume = self._submitted + _OVERLAP

    def window_weight(self, number: int) -> int:
        """How many windows the residual of window `number` stands for; 0 for no evaluation."""
        self._submitted = number
        if not self._is_enabled or number < self._resume:
            return 0
        if number < _EVALUATE_ALL:
            return 1
        return _EVALUATE_EVERY if number % _EVALUATE_EVERY == 0 else 0

    def update(
        self,
        residual: CalibrationResidual,
        weight: int,
        vertical_disparity: VerticalDisparity | None,
    ) -> Correction | None:
        """Add the residual of a window; the new total correction, None for no change.

        Args:
            residual: of the window.
            weight: number of windows that it stands for.
            vertical_disparity: estimated vertical disparities of the pair, None if unknown.
        """
        if self._submitted < self._resume:
            return None
        if isinstance(self._estimator, RadialDistortionEstimator):
            k1 = self._estimator.update(residual, weight)
            return None if k1 is None else RadialDistortionCorrection(k1)
        skew_px = None if vertical_disparity is None else vertical_disparity.skew_px
        bias = self._estimator.update(residual, weight, skew_px)
        if bias is None:
            return None
        offset_px, curve_px = bias.tolist()
        is_yaw = skew_px is not None and is_from_yaw(offset_px, skew_px)
        return DisparityCorrection(offset_px, curve_px, is_yaw)


def _estimator(rig: RectifiedRig) -> DisparityBiasEstimator | RadialDistortionEstimator:
    return DisparityBiasEstimator(rig) if rig.is_metric else RadialDistortionEstimator(rig)
