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
    """Error of a lens, or of both of a pair: `k1` is to be added to its first coefficient."""

    k1: float


Correction = DisparityCorrection | RadialDistortionCorrection


class CalibrationRefiner:
    """Estimates corrections: of the lens, and in stereo of the disparity bias that remains."""

    def __init__(self, rig: RectifiedRig, config: RefinementConfig, *, has_depth: bool) -> None:
        self._rig = rig
        self._has_lens = config.lens_correction and not has_depth
        self._has_bias = rig.is_metric and config.disparity_correction and not has_depth
        self._submitted = 0  # windows
        self._resume = 0  # number of the first window that is evaluated after a suspension
        self.restart()

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Errors that are known now and cannot be corrected."""
        return (*self._lens.faults, *(() if self._bias is None else self._bias.faults))

    def restart(self) -> None:
        """Forget all windows: what they observed was no rigid scene."""
        self._lens = RadialDistortionEstimator(self._rig)
        self._bias = DisparityBiasEstimator(self._rig) if self._rig.is_metric else None

    def suspend(self) -> None:
        """Evaluate no window with any of the newest keyframes.

        To be called at each frame whose observations are not those of a rigid scene, such as things
        that are fixed in the image. Corrections that were found before stay as they are.
        """
        self._resume = self._submitted + _OVERLAP

    def window_weight(self, number: int) -> int:
        """How many windows the residual of window `number` stands for; 0 for no evaluation."""
        self._submitted = number
        if not (self._has_lens or self._has_bias) or number < self._resume:
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
        """Add the residual of so many windows; the new total correction, None for no change."""
        if self._submitted < self._resume:
            return None
        before = self._lens.applied
        k1 = self._lens.update(residual, weight) if self._has_lens else None
        if k1 is not None:
            if self._bias is not None and (before == 0.0) != (k1 == 0.0):
                self._bias = DisparityBiasEstimator(self._rig)  # the other lens had another one
            return RadialDistortionCorrection(k1)
        if self._bias is None or not self._has_bias:
            return None
        skew_px = None if vertical_disparity is None else vertical_disparity.skew_px
        bias = self._bias.update(residual, weight, skew_px)
        if bias is None:
            return None
        offset_px, curve_px = bias.tolist()
        is_yaw = skew_px is not None and is_from_yaw(offset_px, skew_px)
        return DisparityCorrection(offset_px, curve_px, is_yaw)
