"""`vo eval`: how far an estimated trajectory is from the true one."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vo.evaluation.inputs import Inputs
    from vo.evaluation.report import Evaluation


class Align(StrEnum):
    """Choices of `--align`."""

    AUTO = "auto"
    NONE = "none"
    SE3 = "se3"
    SIM3 = "sim3"
    SCALE = "scale"


def eval_command(
    estimate: Annotated[
        Path,
        typer.Argument(
            metavar="ESTIMATE", help="Trajectory file (TUM, KITTI or EuRoC) or the folder of a run."
        ),
    ],
    reference: Annotated[
        Path,
        typer.Argument(metavar="TRUTH", help="Ground truth file, or a recording that has one."),
    ],
    align: Annotated[
        Align,
        typer.Option(
            help="What may be changed to lay the estimate onto the truth. auto: sim3 for a mono "
            "run, else se3."
        ),
    ] = Align.AUTO,
    tolerance: Annotated[
        float,
        typer.Option(
            min=0.0, metavar="SECONDS", help="Largest difference between stamps that count as one."
        ),
    ] = 0.01,
    interpolate: Annotated[
        bool,
        typer.Option(
            "--interpolate/--no-interpolate",
            help="Interpolate the truth at the estimate's stamps instead of taking its nearest "
            "pose.",
        ),
    ] = False,
    delta: Annotated[
        int, typer.Option(min=1, metavar="N", help="Relative error over this many matched poses.")
    ] = 1,
    delta_m: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Relative error over this many metres.",
            show_default="about a tenth of the path",
        ),
    ] = None,
    all_segments: Annotated[
        bool,
        typer.Option("--all-segments", help="Judge all segments of a run as one, not the longest."),
    ] = False,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print JSON for machines instead of a table.")
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Draw path and errors into this file: .png, .pdf or .svg."
        ),
    ] = None,
) -> None:
    """Compare an estimated trajectory with the true one.

    Pairs the poses by stamp, lays the estimate onto the truth (Umeyama 1991)
    and gives ATE, RPE, the drift over sub-paths as on KITTI and the error of scale.

    A run's folder against its sequence, with a picture:

      vo eval out/ my_sequence/ --plot out/eval.png

    Two files, for a script:

      vo eval trajectory.tum groundtruth.txt --align sim3 --json
    """
    from vo.cli.console import standard_error
    from vo.cli.progress import warnings_on
    from vo.evaluation.report import evaluate

    with warnings_on(standard_error()):
        inputs = _load(estimate, reference, all_segments)
    evaluation = evaluate(
        inputs.estimate,
        inputs.reference,
        align.value,
        inputs.mode,
        tolerance_s=tolerance,
        interpolated=interpolate,
        delta_frames=delta,
        delta_m=delta_m,
    )
    if plot is not None:
        from vo.evaluation.plots import save_plot

        save_plot(plot, evaluation, inputs.reference, _title(inputs))
    if json_output:
        _print_json(evaluation, inputs, plot)
    else:
        from vo.cli.eval_table import print_evaluation

        print_evaluation(evaluation, inputs, plot)


def _load(estimate: Path, reference: Path, all_segments: bool) -> Inputs:
    """Both sides; the truth from a file, or else from any recording that brings it along."""
    from vo.errors import SourceError
    from vo.evaluation.inputs import inputs_against, load_inputs
    from vo.sources.registry import open_source

    try:
        return load_inputs(estimate, reference, all_segments=all_segments)
    except SourceError:
        if not _is_recording(reference):
            raise
    truth = open_source(reference).ground_truth
    if truth is None:
        raise SourceError(f"{reference} has no ground truth; give the file of a trajectory")
    return inputs_against(estimate, truth, reference, all_segments=all_segments)


def _is_recording(path: Path) -> bool:
    from vo.errors import SourceError
    from vo.sources.registry import detect_format

    try:
        return path.exists() and bool(detect_format(path))
    except (SourceError, OSError):
        return False


def _title(inputs: Inputs) -> str:
    """Both files, each with the folder it lies in: the names alone say little."""
    names = ["/".join(p.parts[-2:]) for p in (inputs.estimate_path, inputs.reference_path)]
    return f"{names[0]}  against  {names[1]}"


def _print_json(evaluation: Evaluation, inputs: Inputs, plot: Path | None) -> None:
    import json

    result = {
        "estimate": str(inputs.estimate_path),
        "reference": str(inputs.reference_path),
        "mode": inputs.mode,
        **evaluation.to_dict(),
        "plot": None if plot is None else str(plot),
    }
    result["notes"] = [*inputs.notes, *evaluation.notes]
    typer.echo(json.dumps(result, indent=2, allow_nan=False))
