"""The output folder of a run and its files."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

from vo.base.errors import OutputError
from vo.base.files.complete_file import is_full_disk
from vo.base.types import Trajectory
from vo.outputs.results.growing_file import (
    PARTIAL_SUFFIX,
    GrowingFile,
    ReservedSpace,
    RowSpace,
)
from vo.outputs.results.tables import COVARIANCE_HEADING, FRAMES_HEADING, POSES_HEADING
from vo.recordings.formats.trajectory import tum_line

TRAJECTORY = "trajectory.tum"
CAUSAL = "causal.tum"
ODOMETRY = "odometry.tum"
COVARIANCE = "covariance.csv"
POSES = "poses.csv"
FRAMES = "frames.csv"
SUMMARY = "summary.json"
CONFIG = "config.yaml"

_GROWING = (TRAJECTORY, CAUSAL, POSES, COVARIANCE, FRAMES)
GLOBE = "path.geojson", "path.kml", "path_enu.tum"  # only with --georeference
POSITIONS = "given_positions.csv"  # only with --gps
MARKERS = "markers.csv"  # only with --markers
CAMERAS = "cameras.csv"  # only of more than two cameras
CAMERA = "estimated_calibration.yaml"  # only without a calibration

RESULTS = (*_GROWING, ODOMETRY, SUMMARY, CONFIG, *GLOBE, POSITIONS, MARKERS, CAMERAS, CAMERA)
PARTIAL_FILES = tuple(name + PARTIAL_SUFFIX for name in _GROWING)


class RunSpace:
    """Space in the folder of a run, for its summary and its tables; `rows`: expected frames."""

    def __init__(self, folder: Path, rows: int = 0) -> None:
        self.rows = RowSpace(folder, rows)
        self.summary = ReservedSpace(folder)

    def close(self) -> None:
        """Free it."""
        self.rows.close()
        self.summary.close()


class RunFolder:
    """The files that a run writes while it goes on.

    `trajectory`: smoothed poses, one line per frame. `causal`: poses as known when their frame was
    tracked. `poses`: smoothed poses, with number, segment and kind of their frame. `covariance`:
    one line per keyframe. `frames`: one line per frame, as known when it was processed. `path`: the
    folder; created if it is missing; files of an earlier run are removed. `config`: the merged
    settings as YAML. `space`: what was reserved before other outputs were opened.

    Raises:
        OutputError: here and in every method: a file cannot be written.
    """

    def __init__(self, path: Path, config: str, space: RunSpace | None = None) -> None:
        self.path = path
        self._is_finished = False
        try:
            path.mkdir(parents=True, exist_ok=True)
            for name in (*RESULTS, *PARTIAL_FILES):
                (path / name).unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(
                f"cannot write to folder {path}: {error.strerror or error}; choose another `output`"
            ) from error
        self._space = RunSpace(path) if space is None else space
        make_room = self._space.rows.release
        while True:
            try:
                write_atomically(path / CONFIG, config)
                break
            except OutputError as error:
                if not is_full_disk(error) or not make_room():
                    raise
        self.trajectory = GrowingFile(path / TRAJECTORY, make_room=make_room)
        self.causal = GrowingFile(path / CAUSAL, make_room=make_room)
        self.poses = GrowingFile(path / POSES, POSES_HEADING, make_room)
        self.covariance = GrowingFile(path / COVARIANCE, COVARIANCE_HEADING, make_room)
        self.frames = GrowingFile(path / FRAMES, FRAMES_HEADING, make_room)

    @property
    def _growing(self) -> tuple[GrowingFile, ...]:
        return self.trajectory, self.causal, self.poses, self.covariance, self.frames

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Replace the summary atomically, on a full disk too."""
        text = json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
        path = self.path / SUMMARY
        try:
            write_atomically(path, text)
        except OutputError:
            if not self._space.summary.write(path, _partial(path), _encoded(text)):
                raise

    def write_odometry(self, path: Trajectory) -> None:
        """Write the path before loops were closed, beside the one after."""
        lines = map(tum_line, path.stamps_ns.tolist(), path.world_from_cam)
        write_atomically(self.path / ODOMETRY, "".join(f"{line}\n" for line in lines))

    @property
    def is_finished(self) -> bool:
        """Whether the files have their final names."""
        return self._is_finished

    def finish(self) -> None:
        """Close the files and give them their final names; an error of one is raised at the end."""
        self._is_finished = True
        with ThreadPoolExecutor(len(self._growing)) as threads:  # a disk writes all at once
            files = [threads.submit(file.finish) for file in self._growing]
        for file in files:
            file.result()

    def close(self) -> None:
        """Close the files, finished or not."""
        for file in self._growing:
            file.close()
        self._space.close()


def write_atomically(path: Path, text: str) -> None:
    """Write to a temporary file and rename it, so that readers never see a partial file.

    Raises:
        OutputError: it cannot be written.
    """
    partial = _partial(path)
    try:
        partial.write_bytes(_encoded(text))
        os.replace(partial, path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


def _partial(path: Path) -> Path:
    return path.with_name(path.name + PARTIAL_SUFFIX)


def _encoded(text: str) -> bytes:
    # File names may contain bytes that are not UTF-8; JSON reads this form back.
    return text.encode("utf-8", "backslashreplace")
