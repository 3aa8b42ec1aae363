"""`vo demo`: render a synthetic stereo recording, run on it, and evaluate the result."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.errors import MissingExtraError
from vo.base.extras import require
from vo.base.printable import counted
from vo.cli import options
from vo.cli.blocks import option
from vo.cli.echo import echo_json

if TYPE_CHECKING:
    from rich.console import Console

    from vo.outputs.evaluation.evaluation import Evaluation
    from vo.outputs.evaluation.inputs import Inputs
    from vo.outputs.results.summary import Summary


def demo_command(
    *,
    output: Path = option(
        "Folder for the recording and the results.",
        "--output",
        "-o",
        default=Path("out/demo"),
        metavar="FOLDER",
    ),
    printing: options.Printing,
) -> None:
    """Demonstrate visual odometry on a synthetic stereo recording.

    Renders a walk of 20 s around a furnished room (kept for the next time),
    estimates the trajectory, evaluates it against the exact ground truth, and
    prints the paths of the results.

      vo demo
    """
    from vo.cli.console import standard_output
    from vo.cli.eval_table import print_evaluation

    console = standard_output(quiet=printing.quiet or printing.json_output)
    errors = printing.errors
    sequence = _find_or_make_sequence(output, console, errors)
    results = output / "run"
    rrd, picture = _recording_for_viewer(results, errors), results / "eval.png"
    summary = _run(sequence, results, rrd, errors)
    console.print(
        f"tracked     {summary.tracked} of {counted(summary.frames, 'frame')}, "
        f"{summary.frames_per_s:.1f} frames/s\n"
    )
    inputs, evaluation = _evaluate(results, sequence)
    has_picture = _try_to_draw(picture, inputs, evaluation, errors)
    if printing.json_output:
        files = {"recording": sequence, "output": results, "rrd": rrd}
        files["picture"] = picture if has_picture else None
        paths = {name: str(path) for name, path in files.items() if path is not None}
        echo_json({**paths, "summary": summary.to_dict(), "evaluation": evaluation.to_dict()})
    print_evaluation(evaluation, inputs, console=console)
    _print_next_steps(console, sequence, results, rrd, picture if has_picture else None)


def _find_or_make_sequence(output: Path, console: Console, errors: Console) -> Path:
    """The recording, rendered unless it exists; an existing one is always complete."""
    from data_synth.cache import cached_sequence
    from data_synth.recipe import load_recipe
    from vo.cli.progress import frame_bar

    recipe = load_recipe("demo")
    with frame_bar(errors, "preparing the renderer", "rendering") as (bar, show):
        sequence = cached_sequence(recipe, output, "recording", on_frame=show)
        origin = "" if bar.tasks[0].total else " (made earlier)"
    console.print(f"recording   {sequence}{origin}: {recipe.about}", markup=False, soft_wrap=True)
    return sequence


def _recording_for_viewer(results: Path, errors: Console) -> Path | None:
    """Where to record for the viewer; None without its extra, which one line says."""
    try:
        require("rerun", "view", "recordings for the viewer")
    except MissingExtraError as missing:
        errors.print(f"no recording for the viewer: {missing}", markup=False, soft_wrap=True)
        return None
    return results / "run.rrd"


def _run(sequence: Path, results: Path, rrd: Path | None, errors: Console) -> Summary:
    from vo.base.config import load_config
    from vo.cli.console import standard_error
    from vo.cli.messages import warnings_on
    from vo.cli.progress import make_progress
    from vo.runs.run_recording import run

    with warnings_on(standard_error, quiet=errors.quiet):
        progress = make_progress(errors, quiet=errors.quiet)
        return run(sequence, results, config=load_config(), rrd=rrd, progress=progress)


def _evaluate(results: Path, sequence: Path) -> tuple[Inputs, Evaluation]:
    from vo.outputs.evaluation.evaluation import evaluate
    from vo.outputs.evaluation.inputs import load_inputs

    inputs = load_inputs(results, sequence)
    return inputs, evaluate(inputs.estimate, inputs.reference, mode=inputs.mode)


def _try_to_draw(picture: Path, inputs: Inputs, evaluation: Evaluation, errors: Console) -> bool:
    """Save the picture, or say in one line what it needs."""
    from vo.outputs.evaluation.plots import save_plot

    try:
        save_plot(picture, evaluation, inputs.reference, "vo demo: estimate and ground truth")
    except MissingExtraError as missing:
        errors.print(f"no picture: {missing}", markup=False, soft_wrap=True)
        return False
    return True


def _print_next_steps(
    console: Console, sequence: Path, results: Path, rrd: Path | None, picture: Path | None
) -> None:
    vo = _program("vo")
    quoted = [shlex.quote(str(path)) for path in (sequence, results)]
    view = f"  {vo} view {quoted[1]}    # the run in 3D; --web without a screen"
    lines = (
        "",
        *([] if picture is None else [f"picture     {picture}"]),
        *([] if rrd is None else [f"viewer      {rrd}"]),
        f"results     {results}",
        "\nTry next:",
        *([] if rrd is None else [view]),
        f"  {vo} report {quoted[1]}    # one HTML page of the run",
        f"  {vo} eval {quoted[1]} {quoted[0]} --json    # the same figures as JSON",
        f"  {vo} synth out/street --preset kitti    # another scene, camera and motion",
        f"  {vo} run MY_RECORDING --output out/mine    # your own recording, see README.md",
        f"  {vo} --help",
    )
    for line in lines:
        console.print(line, markup=False, soft_wrap=True)


def _program(name: str) -> str:
    """Command that starts a program of this environment."""
    if shutil.which(name):
        return name
    return shlex.quote(os.path.relpath(Path(sys.executable).parent / name))
