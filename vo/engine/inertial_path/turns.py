"""Orientations of frames without a map, in which a single camera only turns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo.base.types import Bools, Floats, Ints, KeyframePose
from vo.engine.inertial.prediction import InertialPredictor
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.turning import (
    Orientations,
    Turn,
    Turning,
    orientations,
    turning_between,
    upright_from_first,
)
from vo.engine.trajectory.builder import TrajectoryBuilder
from vo.engine.trajectory.inertial_frames import InertialFrame

_MAX_UNSEEN_S = 1.0  # between a frame and an image that shows a turn
_UNKNOWN_M = 1000.0  # standard deviation of a position


class InertialTurns:
    """Gives frames of a camera that only turns orientations by the gyroscope.

    Args:
        trajectory: the path.
        predictor: has the rotations by images.
        reader: gives the samples.
        imu_from_cam0: (4, 4) of the recorded camera.
    """

    def __init__(
        self,
        trajectory: TrajectoryBuilder,
        predictor: InertialPredictor,
        reader: SampleReader,
        imu_from_cam0: Floats,
    ) -> None:
        self._trajectory, self._log, self._reader = trajectory, predictor.turns, reader
        self._noise, self._imu_from_cam = predictor.noise, predictor.imu_from_cam
        self._imu_from_cam0 = imu_from_cam0

    def turned(self, done: list[InertialFrame]) -> list[InertialFrame]:
        """Frames with an orientation, without those that have a pose by the sensor already."""
        reached, frames = self._trajectory.reached, self._trajectory.store.frames
        if not self._log.turns:
            return []
        has_pose = np.isin(reached["frame_index"], frames["frame_index"])
        has_pose |= np.isin(reached["frame_index"], [frame.frame_index for frame in done])
        edges = np.flatnonzero(np.diff(np.r_[True, has_pose, True].astype(np.int8)))
        found: list[InertialFrame] = []
        for begin, end in edges.reshape(-1, 2).tolist():
            found += self._of_stretch(reached, begin, end)
        return found

    def _of_stretch(self, reached: NDArray[Any], begin: int, end: int) -> list[InertialFrame]:
        """Those of consecutive frames without a pose, by their rows."""
        stamps = reached["stamp_ns"]
        times = int(stamps[begin]), int(stamps[end - 1])
        turning = turning_between(self._log.turns, times, self._reader, self._imu_from_cam)
        if turning is None:
            return []
        chosen = begin + np.flatnonzero(_is_seen(stamps[begin:end], self._log.turns))
        store = self._trajectory.store
        if begin > 0:
            return self._beside(reached, chosen, begin - 1, turning)
        if end < len(reached):
            return self._beside(reached, chosen, end, turning)
        if store.keyframe_count:
            return []
        return self._alone(reached, chosen, turning)

    def _alone(self, reached: NDArray[Any], rows: Ints, turning: Turning) -> list[InertialFrame]:
        """In a run without any map: the first frame is at the origin of an upright world."""
        found = self._orientations(reached["stamp_ns"][rows], turning)
        if found is None:
            return []
        first = reached[rows[0]]
        world_from_first = np.eye(4)
        world_from_first[:3, :3] = upright_from_first(found.up)
        index, stamp_ns = int(first["frame_index"]), int(first["stamp_ns"])
        self._trajectory.store.store(0, KeyframePose(index, stamp_ns, 0, world_from_first, None))
        return _frames(reached[rows], (0, 0), world_from_first, found)

    def _beside(
        self, reached: NDArray[Any], rows: Ints, row: int, turning: Turning
    ) -> list[InertialFrame]:
        """Before or after a frame with a pose, given by its row."""
        store, at = self._trajectory.store, int(reached["frame_index"][row])
        frame = int(np.searchsorted(store.frames["frame_index"], at))
        if frame == len(store.frames) or int(store.frames["frame_index"][frame]) != at:
            return []
        is_later = row < rows[0]
        stamps = reached["stamp_ns"][np.r_[row, rows] if is_later else np.r_[rows, row]]
        found = self._orientations(stamps, turning)
        if found is None:
            return []
        pose = store.trajectory().world_from_cam[frame]
        if is_later:
            relative, sigma = found.first_from_cam[1:], found.sigma_rad[1:]
        else:
            last_from_first = found.first_from_cam[-1].T
            relative = last_from_first @ found.first_from_cam[:-1]
            sigma = found.sigma_rad[::-1][:-1]
        place = int(store.frames["keyframe"][frame]), int(store.frames["segment"][frame])
        return _frames(reached[rows], place, pose, Orientations(relative, sigma, None))

    def _orientations(self, stamps_ns: Ints, turning: Turning) -> Orientations | None:
        return orientations(turning, stamps_ns, self._reader, self._imu_from_cam0, self._noise)


def _frames(
    rows: NDArray[Any], place: tuple[int, int], reference: Floats, found: Orientations
) -> list[InertialFrame]:
    """Frames at the position of a reference pose (4, 4).

    Args:
        rows: with number and time of the frames.
        place: keyframe and segment.
        reference: (4, 4) world_from_cam0.
        found: their orientations relative to it.
    """
    frames = []
    for k, (index, stamp_ns) in enumerate(rows.tolist()):
        pose = reference.copy()
        pose[:3, :3] = reference[:3, :3] @ found.first_from_cam[k]
        variance = max(float(found.sigma_rad[k]) ** 2, 1e-12)
        covariance = np.diag([variance] * 3 + [_UNKNOWN_M**2] * 3)
        frames.append(
            InertialFrame(place[0], index, stamp_ns, place[1], pose, covariance, has_position=False)
        )
    return frames


def _is_seen(stamps_ns: Ints, turns: list[Turn]) -> Bools:
    """(n,) whether an image within a second shows a turn."""
    ends = np.unique([[turn.first_ns, turn.last_ns] for turn in turns])
    after = np.searchsorted(ends, stamps_ns).clip(1, len(ends) - 1)
    nearest = np.minimum(abs(ends[after] - stamps_ns), abs(ends[after - 1] - stamps_ns))
    return np.asarray(nearest <= _MAX_UNSEEN_S * 1e9)
