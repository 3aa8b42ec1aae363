"""`vo eval`: errors of an estimated trajectory against ground truth."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from vo.cli import options
from vo.cli.blocks import argument, option

if TYPE_CHECKING:
    from vo.outputs.evaluation.evaluation import Evaluation
    from vo.outputs.evaluation.inputs import Inputs

# Headings of the options in `--help`, besides those in `options`.
_PAIRING, _METRICS = "Association and alignment", "Metrics"


class Align(StrEnum):
    """Choices of `--align`."""

    AUTO = "auto"
    NONE = "none"
    SE3 = "se3"
    SIM3 = "sim3"
    SCALE = "scale"


def eval_command(
    estimate: Path = argument(
        "Trajectory file (TUM, KITTI, EuRoC, TartanAir, NeRF), the folder of a run, or a log "
        "with poses.",
        metavar="ESTIMATE",
    ),
    reference: Path = argument(
        "Ground truth file, recording with ground truth, or another run to compare with.",
        metavar="TRUTH",
    ),
    *,
    align: Align = option(
        "Transform that aligns the estimate with the ground truth. auto: sim3 for a mono run, "
        "else se3.",
        default=Align.AUTO,
        panel=_PAIRING,
    ),
    tolerance: float = option(
        "Largest difference between the stamps of a pair.",
        default=0.01,
        min=0.0,
        metavar="SECONDS",
        panel=_PAIRING,
    ),
    interpolate: bool = option(
        "Interpolate the ground truth at the estimate's stamps, or take the nearest pose.",
        "--interpolate/--no-interpolate",
        default=False,
        panel=_PAIRING,
    ),
    delta: int = option(
        "Step of the relative error in matched poses.",
        default=1,
        min=1,
        metavar="N",
        panel=_METRICS,
    ),
    delta_m: float | None = option(
        "Step of the relative error in metres.",
        default=None,
        metavar="METRES",
        show_default="about a tenth of the path",
        panel=_METRICS,
    ),
    all_segments: bool = option(
        "Evaluate all segments of a run as one, not only the longest.",
        "--all-segments",
        default=False,
        panel=_METRICS,
    ),
    calibration: options.Calibration = None,
    topic: list[str] | None = option(
        "Poses in a log: truth=/gt, estimate=/odom, or truth=/tf:map:base_link for frames of "
        "tf; repeatable.",
        default=None,
        metavar="TOPIC",
        show_default="the only topic with poses, or that named like ground truth",
        panel=options.INPUT,
    ),
    printing: options.Printing,
    picture: Path | None = option(
        "Plot path and errors to this .png, .pdf or .svg file.",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    ),
) -> None:
    """Evaluate an estimated trajectory against ground truth.

    Pairs poses by stamp, aligns the estimate (Umeyama 1991) and prints ATE,
    RPE, the drift over sub-paths as in KITTI, and the scale error.

    Evaluate a run against the ground truth of its recording, with a picture:

      vo eval out/ my_sequence/ --picture out/eval.png

    Evaluate a trajectory file, with results for a script:

      vo eval trajectory.tum groundtruth.txt --align sim3 --json

    Compare two runs of a recording:

      vo eval out/fast out/accurate

    Evaluate odometry that was recorded in a log:

      vo eval log.mcap truth.tum --topic estimate=/odom
    """
    from vo.api.eval_inputs import read_inputs
    from vo.base.extras import require
    from vo.cli.eval_table import print_evaluation
    from vo.outputs.evaluation.evaluation import evaluate
    from vo.outputs.results.output_paths import is_run_folder, refuse_to_overwrite

    read = [path for path in (estimate, reference, calibration) if path and not is_run_folder(path)]
    refuse_to_overwrite(read, [picture])
    if picture is not None:
        require("matplotlib", extra="report", what="plots")
    with printing.warnings():
        inputs = read_inputs(
            estimate,
            reference,
            topics=topic or (),
            calibration=calibration,
            all_segments=all_segments,
        )
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
    if picture is not None:
        from vo.outputs.evaluation.plots import save_plot

        save_plot(picture, evaluation, inputs.reference, inputs.title)
    printing.show(
        lambda: _record(evaluation, inputs, picture),
        lambda: print_evaluation(evaluation, inputs, picture),
    )


def _record(evaluation: Evaluation, inputs: Inputs, picture: Path | None) -> dict[str, object]:
    written = None if picture is None else str(picture)
    return {
        "estimate": str(inputs.estimate_path),
        "reference": str(inputs.reference_path),
        "mode": inputs.mode,
        **evaluation.to_dict(),
        "picture": written,
        "plot": written,  # its name in the release before
        "notes": [*inputs.notes, *evaluation.notes],
    }
