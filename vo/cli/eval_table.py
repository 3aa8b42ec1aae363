"""Evaluation as a text table."""

from __future__ import annotations

from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from vo.base.printable import counted
from vo.cli.console import print_table, standard_output
from vo.outputs.evaluation.evaluation import Evaluation
from vo.outputs.evaluation.inputs import Inputs
from vo.outputs.evaluation.pose_errors import PoseErrors, Statistics

_COLUMNS = ("rmse", "mean", "median", "max")


def print_evaluation(
    evaluation: Evaluation,
    inputs: Inputs,
    picture: Path | None = None,
    console: Console | None = None,
) -> None:
    """Print the inputs, the alignment, the errors and the path of the picture."""
    console = console or standard_output()
    for name, value in _facts(evaluation, inputs):
        console.print(f"[bold]{name:<10}[/]", escape(value), soft_wrap=True)
    console.print()
    print_table(console, _errors_table(evaluation, plain=not console.is_terminal))
    if evaluation.segments is not None:
        console.print()
        print_table(console, _segments_table(evaluation, plain=not console.is_terminal))
    for note in (*inputs.notes, *evaluation.notes):
        console.print("\nnote:", note, markup=False, soft_wrap=True)
    if picture is not None:
        console.print(f"\npicture: {picture}", markup=False, soft_wrap=True)


def _facts(evaluation: Evaluation, inputs: Inputs) -> list[tuple[str, str]]:
    matched, alignment = evaluation.matched, evaluation.alignment
    facts = [
        ("estimate", f"{inputs.estimate_path} ({counted(evaluation.estimate_poses, 'pose')})"),
        ("reference", f"{inputs.reference_path} ({counted(evaluation.reference_poses, 'pose')})"),
        (
            "matched",
            f"{counted(len(matched), 'pose')}, {matched.method} within {matched.tolerance_s:g} s; "
            f"{evaluation.path_m:.3f} m in {matched.seconds[-1]:.3f} s; "
            f"{evaluation.coverage:.1%} of the reference's duration, longest gap "
            f"{matched.longest_gap_s:.3f} s",
        ),
        ("alignment", f"{alignment.kind} ({alignment.reason})"),
    ]
    if alignment.kind in ("sim3", "scale"):
        facts.append(("scale", f"multiplied by {alignment.reference_from_estimate.scale:.6f}"))
    elif alignment.scale_error_percent is not None:
        facts.append(("scale", f"error {alignment.scale_error_percent:+.3f} %"))
    return facts


def _errors_table(evaluation: Evaluation, *, plain: bool) -> Table:
    table = _table(plain, "error", "unit", *_COLUMNS)
    alone = Statistics.of(evaluation.rotation_alone_deg)
    table.add_row("ATE, translation", "m", *_numbers(evaluation.ate.translation))
    table.add_row("ATE, rotation", "deg", *_numbers(evaluation.ate.rotation))
    table.add_row("ATE, rotation alone", "deg", *_numbers(alone))
    rows: list[tuple[str, PoseErrors | None]] = [
        (_frames_name(evaluation.delta_frames), evaluation.rpe_frames),
        (f"RPE over {evaluation.delta_m:g} m", evaluation.rpe_metres),
    ]
    for name, errors in rows:
        if errors is None:
            table.add_row(name, "", *("-" for _ in _COLUMNS))
            continue
        table.add_row(f"{name}, translation", "m", *_numbers(errors.translation))
        table.add_row(f"{name}, rotation", "deg", *_numbers(errors.rotation))
    return table


def _frames_name(delta: int) -> str:
    return "RPE per frame" if delta == 1 else f"RPE over {delta} frames"


def _segments_table(evaluation: Evaluation, *, plain: bool) -> Table:
    table = _table(plain, "drift over sub-paths", "count", "translation %", "rotation deg/m")
    segments = evaluation.segments
    assert segments is not None
    for drift in segments.lengths:
        table.add_row(
            f"{drift.length_m:g} m",
            str(drift.count),
            f"{drift.translation_percent:.4f}",
            f"{drift.rotation_deg_per_m:.6f}",
        )
    if len(segments.lengths) > 1:
        table.add_row(
            "all",
            str(sum(drift.count for drift in segments.lengths)),
            f"{segments.translation_percent:.4f}",
            f"{segments.rotation_deg_per_m:.6f}",
        )
    return table


def _table(plain: bool, first: str, *others: str) -> Table:
    """A table with right-aligned numbers; without lines unless it is shown in a terminal."""
    table = Table(box=None if plain else box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(first, no_wrap=True)
    for name in others:
        table.add_column(name, justify="left" if name == "unit" else "right", no_wrap=True)
    return table


def _numbers(statistics: Statistics) -> list[str]:
    return [f"{value:.6f}" for name, value in statistics.to_dict().items() if name in _COLUMNS]
