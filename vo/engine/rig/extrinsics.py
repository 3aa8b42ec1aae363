"""Errors of the extrinsics of a rig, as its windows show them."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.transforms import inverse, rotation_angle, se3_exp
from vo.base.records.calibration_errors import CameraPoseError
from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.rig_extrinsics import ExtrinsicEvidence
from vo.engine.backend.sliding_window import WindowUpdate
from vo.engine.rig.tracker import RigTracker
from vo.engine.rig.window import RigWindow

# Windows are asked that often, and later; of those asked first some share a keyframe.
_EVERY, _EVERY_LATER, _FIRST = 2, 12, 20
_SHARED, _KEPT = 0.5, 0.9  # weight of those asked first, and of all before each new one
_PRIOR = np.repeat([np.deg2rad(1.0), 0.01], 3) ** -2.0  # of a calibration
# Angle, length, and squared Mahalanobis length of an error that is corrected; and of what is left
# of it.
_ERROR, _LEFT = (np.deg2rad(0.15), 0.004, 12.0), (np.deg2rad(0.02), 0.001, 2.0)


class RigExtrinsics:
    """Gathers evidence of windows on the poses of cameras, and corrects what is wrong for sure.

    What is known of the calibration keeps the scale, which windows do not show.

    Attributes:
        body_from_views: (V, 4, 4) in metres.
    """

    def __init__(self, body_from_views: Floats, cameras: Ints) -> None:
        self._first = np.searchsorted(cameras, np.arange(cameras[-1] + 1))
        self._cameras = cameras
        self.body_from_views = self._given = body_from_views
        self._asked = 0
        self._corrected = np.zeros(len(self._first) - 1, dtype=bool)
        self._information, self._gradient, self._suspected = self._nothing()

    @property
    def errors(self) -> tuple[CameraPoseError, ...]:
        """Those that are corrected."""
        found = []
        for camera in (1 + np.flatnonzero(self._corrected)).tolist():
            view = self._first[camera]
            error = inverse(self.body_from_views[view]) @ self._given[view]
            angle, length = np.rad2deg(rotation_angle(error[:3, :3])), np.linalg.norm(error[:3, 3])
            found.append(CameraPoseError(camera, round(float(angle), 3), round(float(length), 4)))
        return tuple(found)

    def moved_cameras(self, cam0_from_body: Floats) -> Floats:
        """(C, 4, 4) by which corrections have moved the cameras, in the frame of camera 0."""
        given, now = self._given[self._first], self.body_from_views[self._first]
        return np.asarray(cam0_from_body @ now @ inverse(cam0_from_body @ given))

    def next_weight(self) -> int:
        """Whether the next window is asked, as its calibration weight."""
        self._asked += 1
        return int(self._asked % (_EVERY if self._asked <= _FIRST else _EVERY_LATER) == 0)

    def correct(self, window: RigWindow, tracker: RigTracker) -> WindowUpdate | None:
        """Take in the newest result of the window, and move views that are wrong."""
        if window.extrinsics is None:
            return None
        wrong = self._take_in(window.extrinsics)
        if not wrong.any():
            return None
        # Far from the truth the first step falls short: the whole map is asked again.
        is_new = bool((wrong & ~self._corrected).any())
        by = self._move(wrong, is_new=is_new)
        tracker.move_views(by)
        return window.move_views(by, calibration_weight=int(is_new))

    def _take_in(self, evidence: ExtrinsicEvidence) -> Bools:
        """(C,) cameras to be corrected: of a new error two windows in turn are certain."""
        weight = _SHARED if self._asked <= _FIRST else 1.0
        self._information = _KEPT * self._information + weight * evidence.information
        self._gradient = _KEPT * self._gradient + weight * evidence.gradient
        before, self._suspected = self._suspected, self._wrong()
        return self._suspected & (before | self._corrected)

    def _move(self, chosen: Bools, *, is_new: bool) -> Floats:
        """Correct cameras (C,); the motions (V, 4, 4) of all views, in their own frames."""
        step, _ = self._solved(chosen)
        self._corrected |= chosen
        tied = self.body_from_views.copy()
        for view, camera in enumerate(self._cameras.tolist()):
            if camera > 0:
                first = self.body_from_views[self._first[camera]]
                moved = se3_exp(step[6 * camera - 6 : 6 * camera])
                tied[view] = first @ moved @ inverse(first) @ tied[view]
        by, self.body_from_views = inverse(self.body_from_views) @ tied, tied
        if is_new:
            self._information, self._gradient, self._suspected = self._nothing()
        else:
            self._gradient += self._information @ step
        return np.asarray(by)

    def _nothing(self) -> tuple[Floats, Floats, Bools]:
        """Evidence of no windows; what they say of far other extrinsics is forgotten."""
        count = len(self._corrected)
        return np.zeros((6 * count, 6 * count)), np.zeros(6 * count), np.zeros(count, dtype=bool)

    def _wrong(self) -> Bools:
        """(C,) cameras whose error is certain."""
        step, covariance = self._solved(np.ones(len(self._corrected), dtype=bool))
        wrong = np.zeros(len(self._corrected), dtype=bool)
        for n, is_known in enumerate(self._corrected.tolist()):
            *least, chi2 = _LEFT if is_known else _ERROR
            for begin, smallest in zip((6 * n, 6 * n + 3), least, strict=True):
                part = slice(begin, begin + 3)
                off = step[part]
                sure = off @ np.linalg.pinv(covariance[part, part], hermitian=True) @ off > chi2
                wrong[n] |= bool(sure) and float(np.linalg.norm(off)) > smallest
        return wrong

    def _solved(self, chosen: Bools) -> tuple[Floats, Floats]:
        """Step (6 C,) of chosen cameras (C,), and its covariance (6 C, 6 C)."""
        information, gradient = self._information.copy(), self._gradient.copy()
        information[np.diag_indices_from(information)] += np.tile(_PRIOR, len(chosen))
        for n, view in enumerate(self._first[1:].tolist()):
            off = inverse(self._given[view]) @ self.body_from_views[view]
            gradient[6 * n + 3 : 6 * n + 6] += _PRIOR[3:] * off[:3, 3]
        rows = np.flatnonzero(np.repeat(chosen, 6))
        covariance, step = np.zeros_like(information), np.zeros_like(gradient)
        covariance[np.ix_(rows, rows)] = np.linalg.inv(information[np.ix_(rows, rows)])
        step[rows] = -covariance[np.ix_(rows, rows)] @ gradient[rows]
        return step, covariance
