"""Runs recordings with and without each addition, and names what makes a path worse.

An addition may help, never harm: nowhere may the error of a path be more than 1.1 times that
without it plus 1 mm, unless the result says so: it is not to be trusted, or has another warning.
A scale may not be wrong by more than three of its standard deviations. What an addition does is
watched in the complete run, and one that does nothing there is not run without. Folders of the
synthetic suite (`scripts/benchmark --suite synthetic`) can be given like others. An example:

  scripts/harm ../shared/data/kitti06_stereo_000-050 out/street --write
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from common import EXPERIMENTS, parser_of, write_section
from robustness_clips import true_poses
from robustness_run import errors, read_poses

import vo
from vo.base.geometry.similarity import umeyama
from vo.base.types import Floats
from vo.engine.frontend.contrast import ContrastCorrection
from vo.engine.frontend.image_fixed import ImageFixed, ImageFixedDetector
from vo.engine.frontend.vertical_disparity import VerticalDisparityCorrection
from vo.engine.mapping.local_map import LocalMap
from vo.engine.tracking.frozen_camera import FrozenCamera
from vo.engine.tracking.step_check import StepCheck
from vo.runs.scaling.scale_sources import ScaleOptions

PAGE = EXPERIMENTS / "harm.md"
MAX_RATIO, MAX_MORE_M, MAX_SIGMAS = 1.1, 0.001, 3.0
_NOISE_M = 0.3  # of positions, along each axis
_KITTI_HEIGHT_M = 1.65
_MARKER_M = 0.16


class Call(NamedTuple):
    """A method that does the work of an addition, and what it returns where it does nothing.

    `acts`: whether a result of the method means that it has changed something.
    """

    owner: type
    name: str
    acts: Callable[[Any], bool]
    nothing: Callable[..., Any] | None = None


class Addition(NamedTuple):
    """What is switched off for comparison: by a setting, or by methods that then do nothing."""

    name: str
    without: tuple[str, ...] = ()
    modes: tuple[str, ...] = ("stereo", "mono")
    calls: tuple[Call, ...] = ()
    key: str = ""  # of `summary.json`, empty or null where it does nothing


_ANY = bool
_CALLED: Callable[[Any], bool] = lambda _: True  # noqa: E731
ADDITIONS = (
    Addition("inertial sensor", ("inertial.enabled=false",), key="inertial"),
    Addition("loops", ("memory.loops=false",), key="loops"),
    Addition(
        "correction of rows",
        ("stereo.row_correction=false",),
        ("stereo",),
        (Call(VerticalDisparityCorrection, "update", _ANY),),
    ),
    Addition(
        "correction of disparities",
        ("refinement.disparity_correction=false",),
        ("stereo",),
        (Call(LocalMap, "correct_disparities", _CALLED),),
    ),
    Addition(
        "correction of the lens",
        ("refinement.lens_correction=false",),
        calls=(Call(LocalMap, "correct_radial_distortion", _CALLED),),
    ),
    Addition(
        "contrast",
        calls=(
            Call(ContrastCorrection, "_raise", _CALLED),
            Call(ContrastCorrection, "update", lambda _: False, lambda _, images: images),
        ),
    ),
    Addition(
        "handling of faults",
        calls=(
            Call(StepCheck, "failure", _ANY, lambda *_: None),
            Call(FrozenCamera, "is_frozen", _ANY, lambda *_: False),
            Call(
                ImageFixedDetector,
                "update",
                lambda found: found.mask is not None,
                lambda *_, **__: ImageFixed(),
            ),
        ),
    ),
)


class Run(NamedTuple):
    """Error of a path in metres, None without one, and what the run says.

    Attributes:
        acting: names of the additions that did something.
        scale: (error, stated standard deviation) in percent, None without a scale.
    """

    ate_m: float | None
    is_trusted: bool
    warnings: tuple[str, ...]
    acting: frozenset[str] = frozenset()
    scale: tuple[float, float] | None = None


def main() -> None:
    """Print the table; with `--write`, into its page too."""
    parser = parser_of("harm", __doc__, "write")
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--end", type=int, help="stop before this frame")
    options = parser.parse_args()
    lines = [
        "| recording | addition | with, m | without, m | |",
        "| --- | --- | ---: | ---: | --- |",
    ]
    for recording in options.recordings:
        for line in rows(recording, options.end):
            lines.append(line)
            print(line, flush=True)
    if options.write:
        write_section(PAGE, "harm", "\n".join(lines))
    sys.exit(any("**harm**" in line for line in lines))


def rows(recording: Path, end: int | None = None) -> Iterator[str]:
    """A row for each mode and addition of a recording with ground truth."""
    name = re.sub(r"-[0-9a-f]{10}$", "", recording.name)  # without the key of a cache
    stream = vo.open(recording)
    for mode in ("stereo", "mono") if stream.rig.is_stereo else ("mono",):
        complete = visual = measure(recording, mode, end=end)
        idle = []
        for addition in (each for each in ADDITIONS if mode in each.modes):
            if addition.name not in complete.acting:
                idle.append(addition.name)
                continue
            without = measure(recording, mode, addition, end=end)
            yield _row(f"{name}, {mode}", addition.name, complete, without)
            if addition is ADDITIONS[0]:
                visual = without
        if idle:
            cells = [f"{name}, {mode}", f"{', '.join(idle)}: inactive", _figure(complete), "same"]
            yield f"| {' | '.join([*cells, ''])} |"
        if mode == "mono":
            yield from _scale_rows(recording, name, visual, end)


def _scale_rows(recording: Path, name: str, visual: Run, end: int | None) -> Iterator[str]:
    """Rows of the sources of scale, which replace an inertial sensor, and keep the path's shape."""
    with tempfile.TemporaryDirectory() as folder:
        positions = Path(folder) / "positions.csv"
        _write_positions(recording, positions)
        sources = {"positions": ScaleOptions(positions=str(positions))}
        if "kitti" in name:
            sources["height"] = ScaleOptions(height_m=_KITTI_HEIGHT_M)
        sources["markers, without any"] = ScaleOptions(marker_length_m=_MARKER_M)
        for source, scale in sources.items():
            run = measure(recording, "mono", end=end, scale=scale)
            yield _row(f"{name}, mono", f"scale by {source}", run, visual)


def _row(name: str, addition: str, complete: Run, without: Run) -> str:
    word = judge(complete, without)
    if complete.scale is not None:
        word += f"{', ' if word else ''}scale {complete.scale[0]:+.1f} ± {complete.scale[1]:.1f} %"
    return f"| {' | '.join([name, addition, _figure(complete), _figure(without), word])} |"


def measure(
    recording: Path,
    mode: str,
    without: Addition | None = None,
    *,
    end: int | None = None,
    scale: ScaleOptions | None = None,
) -> Run:
    """Run on a recording, without an addition."""
    truth = frame_truth(recording)
    counted: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder, _watched(counted, without):
        vo.run(
            recording,
            folder,
            overrides=() if without is None else without.without,
            mode=mode,
            end=end,
            scale=scale or ScaleOptions(),
        )
        poses = Path(folder) / "poses.csv"
        ate_m, _ = errors(poses, truth, mode == "mono")
        summary = json.loads((Path(folder) / "summary.json").read_text(encoding="utf-8"))
        found = _scale_error(poses, truth, summary)
    acting = {each.name for each in ADDITIONS if counted[each.name] or summary.get(each.key)}
    warnings = tuple(summary["warnings"])
    return Run(ate_m, bool(summary["trusted"]), warnings, frozenset(acting), found)


@contextmanager
def _watched(counted: Counter[str], without: Addition | None) -> Iterator[None]:
    """Count what additions do, and let one of them do nothing."""
    with ExitStack() as stack:
        for addition in ADDITIONS:
            for call in addition.calls:
                work = getattr(call.owner, call.name)
                if addition is without and call.nothing is not None:
                    stack.enter_context(patch.object(call.owner, call.name, call.nothing))
                    continue

                def counting(
                    *given: Any,
                    work: Callable[..., Any] = work,
                    call: Call = call,
                    name: str = addition.name,
                    **named: Any,
                ) -> Any:
                    result = work(*given, **named)
                    counted[name] += call.acts(result)
                    return result

                stack.enter_context(patch.object(call.owner, call.name, counting))
        yield


def judge(complete: Run, without: Run) -> str:
    """Whether an addition makes a path worse, and whether the run says it."""
    is_said = not complete.is_trusted or set(complete.warnings) - set(without.warnings)
    if complete.scale is not None:
        if abs(complete.scale[0]) > MAX_SIGMAS * complete.scale[1] and complete.is_trusted:
            return "**harm**"
        is_said = not complete.is_trusted
    if without.ate_m is None:
        return "" if complete.ate_m is None else "helps"
    if complete.ate_m is not None and complete.ate_m <= MAX_RATIO * without.ate_m + MAX_MORE_M:
        return "helps" if without.ate_m > MAX_RATIO * complete.ate_m + MAX_MORE_M else ""
    return "worse, and said" if is_said else "**harm**"


def frame_truth(recording: Path) -> Floats:
    """True poses (N, 4, 4) of the frames of a recording, NaN where unknown."""
    stream = vo.open(recording, mode="mono")
    if stream.ground_truth is None:
        raise SystemExit(f"error: {recording} has no ground truth")
    return true_poses(stream.ground_truth, np.asarray(stream.stamps_ns))


def _write_positions(recording: Path, file: Path) -> None:
    """True positions with noise, as another sensor would give them."""
    truth = vo.open(recording, mode="mono").ground_truth
    assert truth is not None
    noise = np.random.default_rng(0).normal(0.0, _NOISE_M, (len(truth), 3))
    lines = ["time,x,y,z"]
    for stamp_ns, xyz in zip(truth.stamps_ns.tolist(), truth.positions + noise, strict=True):
        lines.append(f"{stamp_ns * 1e-9:.9f},{xyz[0]:.4f},{xyz[1]:.4f},{xyz[2]:.4f}")
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _scale_error(poses: Path, truth: Floats, summary: dict[str, Any]) -> tuple[float, float] | None:
    """Error and stated deviation, in percent, of the scale of the segment that has most frames."""
    scales = summary.get("scales", ())
    if not scales:
        return None
    frames, segments, positions = read_poses(poses)
    best = max(scales, key=lambda each: int((segments == each["segment"]).sum()))
    rows = np.flatnonzero((segments == best["segment"]) & (frames < len(truth)))
    rows = rows[np.isfinite(truth[frames[rows], 0, 3])]
    right = umeyama(positions[rows], truth[frames[rows], :3, 3], with_scale=True).scale
    return 100.0 * (1.0 / right - 1.0), 100.0 * best["sigma"] / best["value"]


def _figure(run: Run) -> str:
    return "no path" if run.ate_m is None else f"{run.ate_m:.4f}"


if __name__ == "__main__":
    main()
