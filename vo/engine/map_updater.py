"""Optimisation of the local map, with its effects on calibration, trajectory and tracking."""

from __future__ import annotations

import numpy as np

from vo.base.faults import Fault
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.base.records.calibration_errors import CalibrationErrors, LensError
from vo.base.stopwatch import Stopwatch, timed
from vo.engine.backend.sliding_window import SlidingWindow, WindowUpdate
from vo.engine.frame_refit import FrameRefit
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.k1_error import edge_shift_px
from vo.engine.geometry.right_camera_error import right_camera_error
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.refinement.calibration_refiner import CalibrationRefiner, DisparityCorrection
from vo.engine.tracking.tracker import Tracker
from vo.engine.trajectory.builder import TrajectoryBuilder

_KnownErrors = tuple[RectifiedRig, VerticalDisparity, CalibrationErrors | None]


class MapUpdater:
    """Submits windows after new keyframes and applies their results, beside tracking.

    Attributes:
        vertical_disparity: as estimated so far, None if it is unknown.
        corrected: vertical disparities corrected in right images.
        refit: fits frames between keyframes again.
        stopwatch: measures the stage `window`.
    """

    def __init__(
        self,
        local_map: LocalMap,
        mapper: LocalMapper,
        tracker: Tracker,
        window: SlidingWindow,
        refiner: CalibrationRefiner,
        trajectory: TrajectoryBuilder,
        refit: FrameRefit,
        stopwatch: Stopwatch,
    ) -> None:
        self.refit = refit
        self.vertical_disparity: VerticalDisparity | None = None
        self.corrected = VerticalDisparity()
        self.stopwatch = stopwatch
        self._map = local_map
        self._mapper = mapper
        self._tracker = tracker
        self._window = window
        self._refiner = refiner
        self._trajectory = trajectory
        self._errors: _KnownErrors = local_map.rig, self.corrected, None
        self._followed = -1  # index of the newest frame that was followed
        self._submitted_with: VerticalDisparity | None = None  # the newest window

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Errors of the calibration that are known now and cannot be corrected."""
        return self._refiner.faults

    @property
    def calibration_errors(self) -> CalibrationErrors:
        """Errors of the calibration that were found and are corrected."""
        rig, corrected, errors = self._errors
        if errors is None or rig is not self._map.rig or corrected is not self.corrected:
            errors = self._errors_now()
            self._errors = self._map.rig, self.corrected, errors
        return errors

    def _errors_now(self) -> CalibrationErrors:
        rig = self._map.rig
        k1 = rig.k1_error
        return CalibrationErrors(
            disparity_offset_px=rig.disparity_offset_px,
            disparity_curve_px=rig.disparity_curve_px,
            right_camera=right_camera_error(self.corrected, rig),
            lens_error=LensError(k1, edge_shift_px(rig, k1)) if k1 != 0.0 else None,
        )

    def follow(self, frame: PreprocessedFrame) -> None:
        """Adapt the map to what is corrected, and uncertain, in the images of a frame."""
        if frame.index <= self._followed:  # it is tracked again, in another map
            return
        self._followed = frame.index
        self._trajectory.reach(frame)
        self.vertical_disparity = frame.vertical_disparity
        if frame.corrected != self.corrected:
            self._correct_vertical_disparity(self.corrected, frame.corrected)
            self.corrected = frame.corrected

    def suspend_if_ambiguous(self, frame: PreprocessedFrame) -> None:
        """Do not use later windows for the calibration if a frame shows no rigid scene."""
        if frame.image_fixed.is_ambiguous:
            self._refiner.suspend()

    def forget_from(self, frame: PreprocessedFrame, segment: int) -> bool:
        """Go back to the state before a frame of a segment, in order to track it anew.

        Corrections of the calibration are taken back, too.

        Returns:
            False if this is impossible, since the scale of the segment would be lost.
        """
        is_metric = self._map.rig.is_metric or frame.depth is not None
        if not is_metric and self._trajectory.store.has_frame(segment, frame.index):
            return False
        self.apply()
        self._followed = frame.index - 1
        self.refit.forget()
        self._refiner.restart()
        self._map.clear_corrected()
        pose = self._trajectory.remove_from(frame.index)
        self._tracker.restart_at(frame.stamp_ns, np.eye(4) if pose is None else pose)
        return True

    def next_frame(self) -> None:
        """Count a frame; apply the pending result if it is due."""
        if self._window.next_frame():
            self.apply()

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Submit the window that ends with a new keyframe, after the result before it."""
        self._trajectory.add_keyframe(keyframe)
        self.apply()
        self._submit()

    def optimise_first_pair(self, first: Keyframe) -> None:
        """Optimise the two keyframes of a new map of a single camera."""
        self._trajectory.add_keyframe(first)
        self._submit()
        self._store_moved(self._window.apply())

    def finish(self) -> None:
        """Apply the last result."""
        self.apply()
        self.refit.finish()

    @timed("window")
    def apply(self) -> None:
        """Wait for the pending result, if there is one, and apply it to the map."""
        update = self._window.apply()
        if update is None:
            return
        # Corrections move keyframes once more: the tracker is moved last, by all of it.
        self._store_moved(update)
        self._refine_calibration(update)
        self._mapper.cull()
        self._mapper.estimate_normals(self._map.keyframes[-1])
        self._tracker.move(update.motion_until_now())
        self.refit.update()

    @timed("window")
    def _correct_vertical_disparity(
        self, before: VerticalDisparity, now: VerticalDisparity
    ) -> None:
        """Apply a new correction of right images to disparities measured before, and optimise.

        The motion model is not moved: its next prediction starts from the old pose.
        """
        self.apply()
        self._map.correct_vertical_disparity(before, now)
        self.refit.forget()
        self._store_moved(self._window.optimise_map())
        self._tracker.forget_kept()

    def _submit(self) -> None:
        self._submitted_with = self.vertical_disparity
        weight = self._refiner.window_weight(self._window.submitted)
        self._window.submit(calibration_weight=weight)

    def _store_moved(self, update: WindowUpdate | None) -> None:
        if update is not None:
            self._trajectory.update(update.moved)

    def _refine_calibration(self, update: WindowUpdate) -> None:
        """Correct the calibration, and the map with it, once its error is certain."""
        residual, weight = update.calibration_residual, update.window.calibration_weight
        if residual is None:
            return
        correction = self._refiner.update(residual, weight, self._submitted_with)
        if correction is None:
            return
        self.refit.forget()
        if isinstance(correction, DisparityCorrection):
            offset_px, curve_px, is_yaw = correction
            self._map.correct_disparities(offset_px, curve_px, is_yaw=is_yaw)
        else:
            self._map.correct_radial_distortion(correction.k1)
        self._store_moved(self._window.optimise_map())
