"""The folder of a run: which files are in it, and that they are all of the same run."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from vo.errors import OutputError
from vo.results.covariance import COVARIANCE_HEADING
from vo.results.frames import FRAMES_HEADING
from vo.results.growing_file import PARTIAL_SUFFIX, GrowingFile
from vo.results.poses import POSES_HEADING

TRAJECTORY = "trajectory.tum"
CAUSAL = "causal.tum"
COVARIANCE = "covariance.csv"
POSES = "poses.csv"
FRAMES = "frames.csv"
SUMMARY = "summary.json"
CONFIG = "config.yaml"

_GROWING = (TRAJECTORY, CAUSAL, POSES, COVARIANCE, FRAMES)
RESULTS = (*_GROWING, SUMMARY, CONFIG)
PARTIAL_FILES = tuple(name + PARTIAL_SUFFIX for name in _GROWING)


class RunFolder:
    """The files that a run writes as it goes.

    Attributes:
        path: the folder.
        trajectory: smoothed poses, a line a frame.
        causal: poses as they were known when their frame was tracked.
        poses: the smoothed poses again, with what is known of their frame.
        covariance: a line a keyframe.
        frames: a line a frame, as it was known then.

    Args:
        path: the folder; made if it is missing, cleared of an earlier run's files.
        config: the merged settings as YAML.

    Raises:
        OutputError: from here and every method, something cannot be written.
    """

    def __init__(self, path: Path, config: str) -> None:
        self.path = path
        try:
            path.mkdir(parents=True, exist_ok=True)
            for name in (*RESULTS, *PARTIAL_FILES):
                (path / name).unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(
                f"cannot write to folder {path}: {error.strerror or error}; give another --output"
            ) from error
        _write_whole(path / CONFIG, config)
        self.trajectory = GrowingFile(path / TRAJECTORY)
        self.causal = GrowingFile(path / CAUSAL)
        self.poses = GrowingFile(path / POSES, POSES_HEADING)
        self.covariance = GrowingFile(path / COVARIANCE, COVARIANCE_HEADING)
        self.frames = GrowingFile(path / FRAMES, FRAMES_HEADING)

    @property
    def _growing(self) -> tuple[GrowingFile, ...]:
        return self.trajectory, self.causal, self.poses, self.covariance, self.frames

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Replace the summary, at once or not at all."""
        text = json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False)
        _write_whole(self.path / SUMMARY, f"{text}\n")

    def finish(self) -> None:
        """Give the growing files their names."""
        for file in self._growing:
            file.finish()

    def close(self) -> None:
        """Let go of the files, finished or not."""
        for file in self._growing:
            file.close()


def _write_whole(path: Path, text: str) -> None:
    """Write beside and rename, so that a reader never sees half a file."""
    partial = path.with_name(path.name + PARTIAL_SUFFIX)
    try:
        # A file name may hold bytes that are no UTF-8; in JSON this form is read back.
        partial.write_text(text, encoding="utf-8", errors="backslashreplace")
        os.replace(partial, path)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
