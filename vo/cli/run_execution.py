"""Execution of `vo run`: start-up, progress, the run itself, and its summary."""

from __future__ import annotations

import logging
import sys
import time
from contextlib import ExitStack
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from vo.cli.flags import known_flags
from vo.cli.garbage import collection_paused
from vo.cli.run_options import Outputs
from vo.cli.run_status import exit_if_insufficient, parse_share
from vo.cli.stopping import IgnoringAtEnd, stop_signals_as_interrupts

if TYPE_CHECKING:
    from subprocess import Popen

    from rich.console import Console

    from vo.base.config import Config
    from vo.cli.run import RunRequest
    from vo.outputs.results.summary import Summary
    from vo.outputs.streaming.sink import PoseSink


def execute(request: RunRequest) -> None:
    """Run the odometry, show its progress, and print its summary.

    Raises:
        VoError: as `vo.runs.run_recording.run`, or a setting is invalid.
        typer.Exit: the run was interrupted, or its path is not what the request asks for.
    """
    begun, fail_under = _process_start(), request.outputs.fail_under
    min_share = None if fail_under is None else parse_share(fail_under)
    quiet = request.printing.quiet
    with stop_signals_as_interrupts(request.output) as signals, ExitStack() as stack:
        with collection_paused():
            config, optimizer_process = _start_optimizer(request, stack)
            import vo.runs.run_recording  # noqa: F401 - loaded while the optimizer's process loads, too
            from vo.cli.console import standard_error
            from vo.cli.progress import make_progress, warnings_on
        console = standard_error()
        stack.enter_context(warnings_on(console, quiet=quiet))
        is_quiet = quiet or _is_terminal_for_poses(request.outputs)
        options = {
            "progress": IgnoringAtEnd(make_progress(console, quiet=is_quiet), signals),
            "profile_since": begun if request.outputs.profile else None,
            "optimizer_process": optimizer_process,
            "flags": known_flags(),
        }
        summary = _run(request, config, options, stack)
        _print_result(summary, request, console)
        if request.viewer.serve:
            signals.obey()  # one of them ends the viewer
    exit_if_insufficient(summary, min_share)


def _process_start() -> float:
    """Start of this process on the clock of `time.perf_counter`."""
    from vo.outputs.results.environment import process_age_s

    return time.perf_counter() - (process_age_s() or 0.0)


def _print_result(summary: Summary, request: RunRequest, errors: Console) -> None:
    """Print the summary as text or JSON; warnings that are not part of a text go to `errors`."""
    from vo.cli.console import standard_output
    from vo.cli.run_table import WrittenFiles, print_summary

    outputs, printing = request.outputs, request.printing
    others = {
        "recording": request.viewer.rrd,
        "mcap": outputs.mcap,
        "colmap": outputs.colmap,
        "ply": outputs.ply,
        "raw frames": request.live.record,
        "map": outputs.save_map,
    }
    files = WrittenFiles.of(request.output, others)
    record = {"output": str(request.output), "files": [str(path) for path in files.paths]}
    console = errors if outputs.poses_on_standard_output else standard_output()
    printing.show(
        lambda: {**summary.to_dict(), **record}, lambda: print_summary(summary, files, console)
    )
    if printing.json_output or printing.quiet:
        for warning in summary.warnings:
            errors.print(f"warning: {warning}", markup=False, soft_wrap=True)


def _start_optimizer(request: RunRequest, stack: ExitStack) -> tuple[Config, Popen[bytes] | None]:
    """Load the settings and start the optimizer's process, before this one loads its modules."""
    from vo.base.config import load_config
    from vo.base.scheduling import available_cores
    from vo.engine.backend.launch import child_started_early

    # Warnings about settings come before the console of the other ones is loaded.
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(logging.Formatter("warning: %(message)s"))
    settings = request.settings
    config = load_config(settings.config, [*settings.all, *request.masks.settings])
    child = stack.enter_context(child_started_early(config.threads or available_cores()))
    return config, child


def _run(request: RunRequest, config: Config, options: dict[str, Any], stack: ExitStack) -> Summary:
    from vo.cli.live_viewer import live_viewer
    from vo.cli.standard_input import NAME, spooled_input
    from vo.outputs.recorders.exports import Exports
    from vo.runs.run_recording import run

    shown, live, outputs, is_piped = request.viewer, request.live, request.outputs, request.is_piped
    poses = _pose_targets(outputs, stack)
    viewer = stack.enter_context(live_viewer(shown.connect, spawn=shown.spawn, serve=shown.serve))
    source = stack.enter_context(spooled_input()) if is_piped else request.source
    return run(
        source,
        request.output,
        config=config,
        **request.reading.keywords,
        **asdict(request.frames),
        side_by_side=request.reading.side_by_side,
        follow=live.follow or is_piped,
        timeout_s=live.timeout,
        duration_s=live.duration,
        record=live.record,
        source_name=NAME if is_piped else None,
        scale=request.scale.sources,
        rrd=shown.rrd,
        rrd_images=shown.rrd_images.value,
        viewer=viewer,
        exports=Exports(mcap=outputs.mcap, colmap=outputs.colmap, ply=outputs.ply),
        poses=poses,
        save_map=outputs.save_map,
        **options,
    )


def _pose_targets(outputs: Outputs, stack: ExitStack) -> list[str | PoseSink]:
    """Where to send poses; standard output is reserved for them if they are written there."""
    from vo.cli.reserved_output import reserved_standard_output
    from vo.outputs.streaming.json_lines import JsonLines

    given = outputs.poses or []
    if not outputs.poses_on_standard_output:
        return list(given)
    lines = JsonLines(stack.enter_context(reserved_standard_output()))
    return [lines if address == "-" else address for address in given]


def _is_terminal_for_poses(outputs: Outputs) -> bool:
    """Whether poses are written to a terminal, where a progress bar would be mixed with them."""
    is_open = sys.stdout is not None and not sys.stdout.closed
    return outputs.poses_on_standard_output and is_open and sys.stdout.isatty()
