"""Records the points of the map as a PLY file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vo.errors import OutputError
from vo.formats.ply import write_ply
from vo.recording.reconstruction import Reconstruction
from vo.recording.recorder import TakeSnapshot
from vo.types import Estimate, Rig, Trajectory


class PlyRecorder:
    """Writes all points that were in the map during the run, at its end.

    Args:
        path: the file; an existing one is replaced.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reconstruction = Reconstruction()

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Check that the file can be written.

        Raises:
            OutputError: it cannot be written.
        """
        self._name = name
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_ply(self._path, np.empty((0, 3)), np.empty(0, np.uint8), name)
        except OSError as error:
            raise OutputError(
                f"points {self._path} cannot be written: {error.strerror or error}; "
                "choose another --ply"
            ) from error

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Add a frame."""
        self._reconstruction.add(estimate, snapshot())

    def finish(self, causal: Trajectory, smoothed: Trajectory) -> None:
        """Write the points.

        Raises:
            OSError: the disk is full.
        """
        models = self._reconstruction.models(smoothed)
        xyz = np.concatenate([np.empty((0, 3)), *(model.xyz for model in models)])
        grey = np.concatenate([np.empty(0, np.uint8), *(model.grey for model in models)])
        write_ply(self._path, xyz, grey, self._name)
