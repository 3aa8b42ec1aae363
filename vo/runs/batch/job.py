"""A recording of a batch with the options of its run, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from enum import StrEnum
from typing import Any

from vo.base.types import Mode


@dataclass(frozen=True)
class Job:
    """A recording and the options of its run; all values are plain, so that it can be sent.

    Attributes:
        name: of its folder below the output of the batch.
        source: path or URL of the recording.
        config: preset or YAML file.
        overrides: settings, `section.key=value`.
        mode: as for `vo run`, like the attributes up to `right_offset_ns`.
        truth: file with ground truth; by default that of the recording.
        is_truth_of_body: whether its poses are those of the body in the calibration, such as an
            IMU, not of cam0.
        tags: labels by name, for tables.
    """

    name: str
    source: str
    config: str = "default"
    overrides: tuple[str, ...] = ()
    mode: Mode = "auto"
    calibration: str | None = None
    format: str | None = None
    topics: tuple[str, ...] = ()
    start: int = 0
    end: int | None = None
    stride: int = 1
    side_by_side: bool = False
    right_offset_ns: int | None = None
    truth: str | None = None
    is_truth_of_body: bool = False
    tags: Mapping[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Job:
        """The job of `to_dict`."""
        lists = {name: tuple(values.get(name) or ()) for name in ("overrides", "topics")}
        return Job(**{**values, **lists})


class JobStatus(StrEnum):
    """How a job ended."""

    DONE = "done"
    FAILED = "failed"  # with an error line of the run
    CRASHED = "crashed"  # the process ended by itself, such as by lack of memory
    TIMED_OUT = "timed out"
    NOT_RUN = "not run"  # the batch was interrupted before


_TYPES: dict[str, Any] = {"str": str, "int": int, "float": (int, float), "Mapping[str,": dict}


@dataclass(frozen=True)
class JobResult:
    """What came of a job; figures are those of `summary.json`, None without a result.

    `ate_m` and the drift (as in KITTI) are of the longest segment where there is ground truth; in
    mono after alignment with scale. `attempts` are the processes that were started for it.
    """

    name: str
    source: str
    status: JobStatus
    error: str | None = None
    attempts: int = 0
    fingerprint: str = ""
    tags: Mapping[str, str] = field(default_factory=dict)
    verdict: str | None = None
    trusted: bool | None = None
    frames: int | None = None
    tracked_ratio: float | None = None
    segments: int | None = None
    path_m: float | None = None
    length_unit: str | None = None
    ate_m: float | None = None
    causal_ate_m: float | None = None
    drift_percent: float | None = None
    drift_deg_per_100m: float | None = None
    wall_s: float | None = None
    cpu_s: float | None = None
    frames_per_s: float | None = None
    peak_rss_mb: float | None = None
    warnings: tuple[str, ...] = ()

    @property
    def is_done(self) -> bool:
        """Whether the run finished."""
        return self.status is JobStatus.DONE

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**asdict(self), "status": self.status.value, "warnings": list(self.warnings)}

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> JobResult:
        """The result of `to_dict`; unknown keys, of a later version, are left out.

        Raises:
            ValueError, TypeError: it is not one.
        """
        if not isinstance(values, dict):
            raise TypeError("no result")
        types = {f.name: _TYPES.get(f.type.partition(" ")[0]) for f in fields(JobResult)}
        kept = {name: value for name, value in values.items() if name in types}
        for name, value in kept.items():
            wanted = types[name]
            if value is not None and wanted is not None and not isinstance(value, wanted):
                raise TypeError(f"{name} is {value}")
        kept["status"] = JobStatus(kept["status"])
        kept["tags"] = {str(tag): str(value) for tag, value in (kept.get("tags") or {}).items()}
        kept["warnings"] = tuple(map(str, kept.get("warnings") or ()))
        return JobResult(**kept)
