"""Summary of a run as a text table, with advice and next commands."""

from __future__ import annotations

import glob
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.markup import escape

from vo.base.printable import counted
from vo.base.records.closed_loops import ClosedLoop, Relocalisation
from vo.base.records.metric_scale import MetricScale
from vo.cli.advice import advice, verdict_sentence
from vo.cli.console import standard_output
from vo.outputs.results.folder import RESULTS
from vo.outputs.results.run_statistics import Profile
from vo.outputs.results.summary import Summary

_COLOURS = {"good": "[green]", "caution": "[yellow]", "bad": "[red]"}


class WrittenFiles(NamedTuple):
    """The folder of a run, names of files in it, and other files by what they are called."""

    folder: Path
    names: tuple[str, ...]
    others: Mapping[str, Path]

    @classmethod
    def of(cls, folder: Path, others: Mapping[str, Path | None]) -> WrittenFiles:
        """Those of the possible files that exist."""
        names = tuple(name for name in RESULTS if (folder / name).exists())
        found = {what: path for what, path in others.items() if path is not None and path.exists()}
        return cls(folder, names, found)

    @property
    def paths(self) -> list[Path]:
        """All of them."""
        return [*(self.folder / name for name in self.names), *self.others.values()]


def print_summary(
    summary: Summary,
    files: WrittenFiles,
    console: Console | None = None,
    options: Sequence[str] = (),
) -> None:
    """Print the verdict on a run, figures, files, warnings, advice and next commands.

    `options`: those of the run that another one needs to be the same, as words of the command.
    """
    output, rrd = files.folder, files.others.get("recording")
    console = console or standard_output()
    colour, sentence = _COLOURS[summary.verdict.grade], verdict_sentence(summary)
    console.print(f"[bold]{'result':<10} {colour}{escape(sentence)}[/][/]", soft_wrap=True)
    for name, value in (*_facts(summary), *_files(files)):
        console.print(f"[bold]{name:<10}[/]", escape(value), soft_wrap=True)
    lines = [("[yellow]warning:[/]", warning) for warning in summary.closing_warnings]
    lines += [("[cyan]try:[/]", line) for line in advice(summary, is_recorded=rrd is not None)]
    lines += [
        ("[cyan]next:[/]", command) for command in _next_commands(summary, output, rrd, options)
    ]
    for label, line in lines:
        console.print(label, escape(line), soft_wrap=True)


def _facts(summary: Summary) -> list[tuple[str, str]]:
    unit = summary.length_unit
    kind = f"{summary.facts.mode}, {summary.facts.format}"
    inertial = summary.inertial_poses
    speed = f"{summary.frames_per_s:.1f} frames/s, {summary.wall_s:.1f} s"
    facts = [
        ("source", f"{summary.facts.source} ({kind})"),
        *([("masks", _masks(summary.hidden))] if any(summary.hidden) else []),
        ("frames", _frames(summary)),
        ("tracked", f"{summary.tracked} ({_percent(summary.tracked, summary.frames)})"),
        *([("between", f"{summary.interpolated} interpolated")] if summary.interpolated else []),
        *([("bridged", f"{inertial} by the inertial sensor")] if inertial else []),
        ("lost", str(summary.lost)),
        ("segments", str(len(summary.segments))),
        *([("loops", _loops(summary.loops))] if summary.loops else []),
        *_relocalisations(summary.relocalisations),
        *_inertial(summary),
        ("keyframes", f"{summary.keyframes}, with {counted(summary.landmarks, 'landmark')}"),
        ("path", f"{summary.path_m:.3f} {unit}"),
        *([("scale", _scales(summary.scale.scales))] if summary.scale else []),
        ("speed", f"{speed}, peak memory {summary.peak_rss_mb:.0f} MB"),
    ]
    if summary.live is not None and summary.live.delay_ms is not None:
        delay = summary.live.delay_ms
        facts.append(
            ("delay", f"{delay.median:.0f} ms from image to pose, at most {delay.max:.0f}")
        )
    if summary.profile is not None:
        facts.append(("profile", _profile(summary.profile)))
    return facts


def _loops(loops: Sequence[ClosedLoop]) -> str:
    """How many keyframes see a place again, and how many segments this connects to others."""
    joined = len({loop.segment for loop in loops if loop.joins and not loop.repairs})
    again = counted(len(loops), "keyframe") + " at known places"
    return f"{again}, {counted(joined, 'segment')} connected by them" if joined else again


def _scales(scales: Sequence[MetricScale]) -> str:
    """Scale and relative uncertainty of each world."""
    parts = [
        f"{s.value:.4g} m per map unit, ± {s.relative_sigma:.2%} ({s.source})"
        + (f" in segment {s.segment}" if len(scales) > 1 else "")
        for s in scales
    ]
    return "; ".join(parts) or "unknown"


def _relocalisations(found: Sequence[Relocalisation]) -> list[tuple[str, str]]:
    """The first frames in an older world, if there are any."""
    if not found:
        return []
    frames = ", ".join(str(each.frame) for each in found)
    return [("relocalised", f"in {'frame' if len(found) == 1 else 'frames'} {frames}")]


def _inertial(summary: Summary) -> list[tuple[str, str]]:
    """What the inertial sensor gave, or why it gave nothing; nothing if the warnings say it."""
    use = summary.inertial
    if use is None or (use.states is None and summary.inertial_orientations):
        return []
    if use.states is None:
        return [] if use.is_error else [("inertial", f"not used: {use.reason}")]
    down = f"gravity within {use.states.tilt_sigma_deg:.2f}°"
    if summary.facts.mode != "mono":
        return [("inertial", f"{down}, from frame {use.first_frame}")]
    scale = f"scale within {100 * use.states.scale_sigma:.1f} %"
    return [("inertial", f"{scale}, {down} (standard deviations), from frame {use.first_frame}")]


def _masks(hidden: Sequence[float]) -> str:
    if len(hidden) == 1:
        return f"{hidden[0]:.1%} of the images not used"
    parts = [f"{r:.1%} of the {side}" for r, side in zip(hidden, ("left", "right"), strict=True)]
    return f"{' and '.join(parts)} images not used"


def _files(files: WrittenFiles) -> list[tuple[str, str]]:
    rows = [("output", f"{files.folder}: {', '.join(files.names)}")]
    return rows + [(what, str(path)) for what, path in files.others.items()]


def _profile(profile: Profile) -> str:
    """Time of each stage in seconds, the largest first."""
    stages = sorted(profile.stages_ms.items(), key=lambda item: -item[1])
    parts = [f"{stage} {1e-3 * spent:.2f}" for stage, spent in stages]
    return f"{1e-3 * profile.wall_ms:.2f} s: " + ", ".join(parts)


def _frames(summary: Summary) -> str:
    others = {"during initialisation": summary.starting, "skipped": len(summary.skipped)}
    notes = [f"{count} {what}" for what, count in others.items() if count]
    return ", ".join((str(summary.frames), *notes))


def _percent(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.1f} %" if whole else "-"


def _next_commands(
    summary: Summary, output: Path, rrd: Path | None, options: Sequence[str]
) -> list[str]:
    facts, commands = summary.facts, []
    if summary.tracked and facts.has_ground_truth:
        calibration = [] if facts.calibration is None else ["--calibration", facts.calibration]
        commands.append(["vo", "eval", output, facts.source, *calibration])
    if summary.tracked:
        commands.append(["vo", "report", output])
    if rrd is not None:
        commands.append(["vo", "view", rrd])
    elif Path(facts.source).exists() or glob.has_magic(facts.source):  # not after one from a pipe
        again = ["vo", "run", facts.source, "--output", output, *options]
        commands.append([*again, "--rrd", output / "run.rrd"])
    return [shlex.join(map(str, command)) for command in commands]
