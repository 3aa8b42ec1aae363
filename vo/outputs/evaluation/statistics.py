"""Pose errors as arrays, and their statistics."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats


@dataclass(frozen=True)
class Statistics:
    """Statistics of a set of errors, in the unit of the errors."""

    rmse: float  # root of the mean square
    mean: float
    median: float
    max: float  # largest
    min: float  # smallest
    std: float  # standard deviation of the population

    @staticmethod
    def of(errors: Floats) -> Statistics:
        """The statistics of (N,) errors, N at least 1."""
        return Statistics(
            rmse=float(np.sqrt(np.mean(errors**2))),
            mean=float(np.mean(errors)),
            median=float(np.median(errors)),
            max=float(np.max(errors)),
            min=float(np.min(errors)),
            std=float(np.std(errors)),
        )

    def to_dict(self) -> dict[str, float]:
        """The numbers by name."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of N poses or N motions."""

    translation_m: Floats  # (N,) lengths in metres
    rotation_deg: Floats  # (N,) angles in degrees, 0 to 180

    def __len__(self) -> int:
        return len(self.translation_m)

    @property
    def translation(self) -> Statistics:
        """Statistics of the lengths, in metres."""
        return Statistics.of(self.translation_m)

    @property
    def rotation(self) -> Statistics:
        """Statistics of the angles, in degrees."""
        return Statistics.of(self.rotation_deg)

    def to_dict(self) -> dict[str, dict[str, float]]:
        """Both statistics, by name and unit."""
        return {
            "translation_m": self.translation.to_dict(),
            "rotation_deg": self.rotation.to_dict(),
        }


def relative_poses(first: Floats, second: Floats) -> Floats:
    """first_from_second, (N, 4, 4), of two poses (N, 4, 4) in the same world."""
    return inverse(first) @ second


def rotation_angles_deg(rotations: Floats) -> Floats:
    """Angles (N,) in degrees of rotations (N, 3, 3), accurate near 0 and near 180."""
    twice_sine_axis = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ]
    )
    twice_cosine = np.trace(rotations, axis1=1, axis2=2) - 1.0
    angles = np.arctan2(np.linalg.norm(twice_sine_axis, axis=0), twice_cosine)
    return np.asarray(np.rad2deg(angles), dtype=np.float64)


def path_distances(positions: Floats) -> Floats:
    """Metres travelled (N,) from the first of (N, 3) positions to each."""
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])
