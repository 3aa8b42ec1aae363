"""Arguments of `vo run`, grouped as in its `--help`; their meaning is that of the options."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple


class Input(NamedTuple):
    """The recording and the frames to use."""

    source: str
    calibration: Path | None
    mode: Literal["auto", "mono", "stereo"]
    topics: tuple[str, ...]
    right_offset_ns: int | None
    format: str | None
    follow: bool
    start: int
    end: int | None
    stride: int
    side_by_side: bool
    timeout_s: float | None
    duration_s: float | None
    record: Path | None

    @property
    def is_piped(self) -> bool:
        """Whether the recording is read from standard input."""
        return self.source == "-"


class Settings(NamedTuple):
    """Settings of the odometry; `masks` are texts of that section by key, empty if not given."""

    config: str
    overrides: tuple[str, ...]
    threads: int | None
    loops: bool | None
    vocabulary: Path | None
    map: Path | None
    localize: bool
    masks: Mapping[str, Sequence[str]]
    no_imu: bool = False

    @property
    def all_overrides(self) -> list[str]:
        """Overrides of settings, including those that have options of their own."""
        threads = [] if self.threads is None else [f"threads={self.threads}"]
        files = {"vocabulary": self.vocabulary, "map": self.map}
        given: dict[str, str | bool] = {
            name: str(path) for name, path in files.items() if path is not None
        }
        loops = True if self.loops is None and self.map is not None else self.loops
        switches = {"loops": loops, "localize": self.localize or None}
        given |= {name: is_on for name, is_on in switches.items() if is_on is not None}
        memory = [f"memory.{name}={json.dumps(value)}" for name, value in given.items()]
        masks = [f"masks.{k}={json.dumps(texts)}" for k, texts in self.masks.items() if texts]
        imu = ["inertial.enabled=false"] if self.no_imu else []
        return [*self.overrides, *threads, *memory, *imu, *masks]


class Scale(NamedTuple):
    """Where the metric scale of a mono run comes from."""

    positions: str | None
    offset_ns: int
    georeference: bool
    height_m: float | None = None
    marker_length_m: float | None = None
    marker_dictionary: str = "auto"
    world: str | None = None
    marker_map: Path | None = None
    lever_arm_m: tuple[float, float, float] | None = None


class Visualisation(NamedTuple):
    """Recording and streaming for the rerun viewer."""

    rrd: Path | None
    rrd_images: Literal["full", "half", "none"]
    spawn: bool
    connect: str | None
    serve: bool


class Outputs(NamedTuple):
    """Files and text to write; `profile_since` is the process start on `time.perf_counter`.

    `poses` are addresses of `vo.outputs.streaming.address`.
    """

    folder: Path
    mcap: Path | None
    colmap: Path | None
    ply: Path | None
    profile_since: float | None
    quiet: bool
    poses: tuple[str, ...] = ()
    save_map: Path | None = None

    @property
    def poses_on_standard_output(self) -> bool:
        """Whether nothing else may be written there."""
        return "-" in self.poses


class ForScripts(NamedTuple):
    """Whether the summary is printed as JSON, and the fraction of frames that must have a pose."""

    json: bool
    min_share: float | None


class RunRequest(NamedTuple):
    """All arguments of `vo run`."""

    input: Input
    settings: Settings
    scale: Scale
    visualisation: Visualisation
    outputs: Outputs
    scripts: ForScripts
