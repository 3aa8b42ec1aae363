"""Runs `vo run` on one recording, and compares its path with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from common import run_vo

from vo.base.types import Floats, Ints

_MIN_POSES = 3  # of a segment, to align it
_TIMEOUT_S = 1200
_COLUMNS = 12  # of poses.csv
FLOOR_RATIO, FLOOR_M = 0.0005, 0.002
MAX_ATE_RATIO = 3.0


@dataclass(frozen=True)
class Outcome:
    """What a run made of a recording."""

    # root mean square of the position errors, None without a path. Each segment is aligned by
    # itself; with scale where the path is not in metres
    ate_m: float | None
    tracked: float  # frames with a pose, as a ratio
    longest_step_m: float  # longest distance between neighbouring frames
    verdict: str
    is_trusted: bool  # whether the run says that its path can be trusted
    # kinds of faults that it reported; `!` after those that it could not handle
    faults: tuple[str, ...]
    warning: str  # the first warning, or the error that refused the recording
    error: bool = False  # whether the command failed


def run(
    vo: Path, recording: Path, truth: Floats, output: Path, arguments: tuple[str, ...] = ()
) -> Outcome:
    """Run on a recording whose frames have these true poses (N, 4, 4), NaN where unknown."""
    process = run_vo(recording, output, *arguments, vo=vo, timeout_s=_TIMEOUT_S)
    if process.wall_s > _TIMEOUT_S:
        return Outcome(None, 0.0, 0.0, "hangs", False, (), f"no end after {_TIMEOUT_S} s", True)
    if process.failure or not (output / "summary.json").is_file():
        is_known = process.status == 1 and "Traceback" not in process.stderr
        verdict = "refused" if is_known else f"exit status {process.status}"
        text = process.failure.removeprefix("error: ")
        return Outcome(None, 0.0, 0.0, verdict, False, (), text, error=True)
    summary = process.summary
    has_no_scale = summary["mode"] == "mono" and summary["length_unit"] != "m"
    ate, step = errors(output / "poses.csv", truth, has_no_scale)
    verdict = _verdict(summary, process.stdout)
    return Outcome(
        ate,
        (summary["tracked"] + summary["interpolated"]) / max(1, summary["frames"]),
        step,
        verdict,
        bool(summary.get("trusted", _looks_trusted(verdict))) and ate is not None,
        tuple(f["kind"] + ("" if _is_handled(f) else "!") for f in summary.get("faults", ())),
        next(iter(_told(summary)), ""),
    )


def errors(poses: Path, truth: Floats, with_scale: bool) -> tuple[float | None, float]:
    """ATE and longest step of a `poses.csv`, in metres."""
    frames, segments, positions = read_poses(poses)
    known = frames < len(truth)
    known[known] = np.isfinite(truth[frames[known], 0, 3])
    squares, longest = [], 0.0
    for segment in np.unique(segments):
        rows = np.flatnonzero(segments == segment)
        there = rows[known[rows]]
        if len(there) < _MIN_POSES:
            continue
        aligned = align(positions[there], truth[frames[there], :3, 3], with_scale)
        residual = aligned(positions[there]) - truth[frames[there], :3, 3]
        squares.append((residual**2).sum(axis=1))
        path = aligned(positions[rows])
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1) / np.diff(frames[rows])
        longest = max(longest, float(steps.max()))
    return (float(np.sqrt(np.concatenate(squares).mean())) if squares else None), longest


def align(estimate: Floats, reference: Floats, with_scale: bool):  # type: ignore[no-untyped-def]
    """The best transform of (N, 3) points to others, also where all are in one place.

    Source: Umeyama, "Least-squares estimation of transformation parameters", 1991, eq. 40 to 42.
    """
    a, b = estimate.mean(axis=0), reference.mean(axis=0)
    u, d, vt = np.linalg.svd((reference - b).T @ (estimate - a))
    sign = np.ones(3)
    sign[2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation = (u * sign) @ vt
    spread = ((estimate - a) ** 2).sum()
    scale = float((d * sign).sum() / spread) if with_scale and spread > 0 else 1.0
    return lambda points: scale * (points - a) @ rotation.T + b


def read_poses(file: Path) -> tuple[Ints, Ints, Floats]:
    """Frame numbers, segments and positions of a `poses.csv`."""
    rows = [line.split(",") for line in file.read_text(encoding="utf-8").splitlines()[1:]]
    table = np.array([[float(x) for x in row] for row in rows]).reshape(-1, _COLUMNS)
    return table[:, 0].astype(np.int64), table[:, 2].astype(np.int64), table[:, 5:8]


def path_m(truth: Floats) -> float:
    """Length of the true path."""
    positions = truth[np.isfinite(truth[:, 0, 3]), :3, 3]
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def max_ate_m(clean: Outcome, truth: Floats, floor_ratio: float = FLOOR_RATIO) -> float:
    """Largest ATE of a path that counts as right."""
    floor = floor_ratio * path_m(truth) + FLOOR_M
    return max(MAX_ATE_RATIO * (clean.ate_m or 0.0), floor)


def _verdict(summary: dict[str, Any], stdout: str) -> str:
    given = summary.get("verdict")
    if isinstance(given, dict):
        given = given.get("sentence")
    if given:
        return str(given)
    line = next((x for x in stdout.splitlines() if x.startswith("result")), "")
    return line.removeprefix("result").strip()


def _looks_trusted(verdict: str) -> bool:
    """Whether the sentence of a version without the field `trusted` sounds like it."""
    return verdict.startswith("complete") and "unreliable" not in verdict


def _is_handled(fault: dict[str, Any]) -> bool:
    return bool(fault.get("is_handled", fault.get("handled", False)))


def _told(summary: dict[str, Any]) -> list[str]:
    """Warnings but the one that every mono run has."""
    return [w for w in summary["warnings"] if not w.startswith("mono: the scale is unknown")]
