"""`vo demo`: render a synthetic stereo recording, run on it, and evaluate the result."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vo.errors import MissingExtraError

if TYPE_CHECKING:
    from rich.console import Console

    from vo.evaluation.inputs import Inputs
    from vo.evaluation.report import Evaluation


def demo_command(
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER",
            help="Folder for the recording and the results.",
        ),
    ] = Path("out/demo"),
) -> None:
    """Demonstrate visual odometry on a synthetic stereo recording.

    Renders a walk of 20 s around a furnished room (kept for the next time),
    estimates the trajectory, evaluates it against the exact ground truth, and
    prints the paths of the results.

      vo demo
    """
    from vo.cli.console import standard_output

    console = standard_output()
    sequence = _find_or_make_sequence(output, console)
    results = output / "run"
    rrd, plot = results / "run.rrd", results / "eval.png"
    _run(sequence, results, rrd, console)
    inputs, evaluation = _evaluate(results, sequence)
    has_plot = _try_to_plot(plot, inputs, evaluation, console)
    from vo.cli.eval_table import print_evaluation

    print_evaluation(evaluation, inputs, console=console)
    _print_next_steps(console, sequence, results, rrd, plot if has_plot else None)


def _find_or_make_sequence(output: Path, console: Console) -> Path:
    """The recording, rendered unless it exists; an existing one is always complete."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn

    from data_synth.cache import cached_sequence
    from data_synth.recipe import load_recipe

    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("preparing the renderer", total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, description="rendering", completed=done, total=total)

        recipe = load_recipe("demo")
        sequence = cached_sequence(recipe, output, "recording", on_frame=show)
        origin = "" if bar.tasks[0].total else " (made earlier)"
    console.print(f"recording   {sequence}{origin}: {recipe.about}", markup=False, soft_wrap=True)
    return sequence


def _run(sequence: Path, results: Path, rrd: Path, console: Console) -> None:
    from vo.cli.progress import make_progress, warnings_on
    from vo.config import load_config
    from vo.run_recording import run

    with warnings_on(console):
        progress = make_progress(console, quiet=False)
        summary = run(sequence, results, config=load_config(), rrd=rrd, progress=progress)
    console.print(
        f"tracked     {summary.tracked} of {summary.frames} frames, "
        f"{summary.frames_per_s:.1f} frames/s\n"
    )


def _evaluate(results: Path, sequence: Path) -> tuple[Inputs, Evaluation]:
    from vo.evaluation.inputs import load_inputs
    from vo.evaluation.report import evaluate

    inputs = load_inputs(results, sequence)
    return inputs, evaluate(inputs.estimate, inputs.reference, mode=inputs.mode)


def _try_to_plot(plot: Path, inputs: Inputs, evaluation: Evaluation, console: Console) -> bool:
    """Save the plot, or say in one line what it needs."""
    from vo.evaluation.plots import save_plot

    try:
        save_plot(plot, evaluation, inputs.reference, "vo demo: estimate and ground truth")
    except MissingExtraError as missing:
        console.print(f"no plot: {missing}", markup=False, soft_wrap=True)
        return False
    return True


def _print_next_steps(
    console: Console, sequence: Path, results: Path, rrd: Path, plot: Path | None
) -> None:
    vo, rerun = _program("vo"), _program("rerun")
    quoted = [shlex.quote(str(path)) for path in (sequence, results, rrd)]
    lines = (
        "",
        *([] if plot is None else [f"plot        {plot}"]),
        f"rerun file  {rrd}",
        f"results     {results}",
        "\nTry next:",
        f"  {rerun} {quoted[2]}    # view the run in 3D",
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
