"""Execution of `vo run`: start-up, progress, the run itself, and its summary."""

from __future__ import annotations

import logging
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING

from vo.cli.echo import echo_json
from vo.cli.garbage import collection_paused
from vo.cli.run_request import Outputs, RunRequest, Settings
from vo.cli.run_status import exit_if_insufficient
from vo.cli.stopping import IgnoringAtEnd, stop_signals_as_interrupts

if TYPE_CHECKING:
    from subprocess import Popen

    from rich.console import Console

    from vo.base.config import Config
    from vo.outputs.results.summary import Summary
    from vo.outputs.streaming.sink import PoseSink
    from vo.runs.progress import Progress


def execute(request: RunRequest) -> None:
    """Run the odometry, show its progress, and print its summary.

    Raises:
        VoError: as `vo.runs.run_recording.run`, or a setting is invalid.
        typer.Exit: the run was interrupted, or its path is not what the request asks for.
    """
    outputs = request.outputs
    with stop_signals_as_interrupts(outputs.folder) as signals, ExitStack() as stack:
        with collection_paused():
            config, optimizer_process = _start_optimizer(request.settings, stack)
            import vo.runs.run_recording  # noqa: F401 - loaded while the optimizer's process loads, too
            from vo.cli.console import standard_error
            from vo.cli.progress import make_progress, warnings_on
        console = standard_error()
        stack.enter_context(warnings_on(console, quiet=outputs.quiet))
        is_quiet = outputs.quiet or _is_terminal_for_poses(outputs)
        progress = IgnoringAtEnd(make_progress(console, quiet=is_quiet), signals)
        summary = _run(request, config, optimizer_process, progress, stack)
        _print_result(summary, request, console)
        if request.visualisation.serve:
            signals.obey()  # one of them ends the viewer
    exit_if_insufficient(summary, request.scripts.min_share)


def _print_result(summary: Summary, request: RunRequest, errors: Console) -> None:
    """Print the summary as text or JSON; warnings that are not part of a text go to `errors`."""
    from vo.cli.console import standard_output
    from vo.cli.run_table import WrittenFiles, print_summary

    outputs, rrd = request.outputs, request.visualisation.rrd
    others = {"mcap": outputs.mcap, "colmap": outputs.colmap, "ply": outputs.ply}
    files = WrittenFiles.of(
        outputs.folder,
        {"recording": rrd, **others, "raw frames": request.input.record, "map": outputs.save_map},
    )
    if request.scripts.json:
        paths = [str(path) for path in files.paths]
        echo_json({**summary.to_dict(), "output": str(outputs.folder), "files": paths})
    elif not outputs.quiet:
        to_errors = outputs.poses_on_standard_output
        print_summary(summary, files, errors if to_errors else standard_output())
        return
    for warning in summary.warnings:
        errors.print(f"warning: {warning}", markup=False, soft_wrap=True)


def _start_optimizer(settings: Settings, stack: ExitStack) -> tuple[Config, Popen[bytes] | None]:
    """Load the settings and start the optimizer's process, before this one loads its modules."""
    from vo.base.config import load_config
    from vo.base.scheduling import available_cores
    from vo.engine.backend.launch import child_started_early

    # Warnings about settings come before the console of the other ones is loaded.
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(logging.Formatter("warning: %(message)s"))
    config = load_config(settings.config, settings.all_overrides)
    child = stack.enter_context(child_started_early(config.threads or available_cores()))
    return config, child


def _run(
    request: RunRequest,
    config: Config,
    optimizer_process: Popen[bytes] | None,
    progress: Progress,
    stack: ExitStack,
) -> Summary:
    from vo.cli.live_viewer import live_viewer
    from vo.cli.standard_input import NAME, spooled_input
    from vo.outputs.recorders.exports import Exports
    from vo.runs.run_recording import run
    from vo.runs.scaling.creation import ScaleOptions

    given, shown, outputs = request.input, request.visualisation, request.outputs
    poses = _pose_targets(outputs, stack)
    viewer = stack.enter_context(live_viewer(shown.connect, spawn=shown.spawn, serve=shown.serve))
    source = stack.enter_context(spooled_input()) if given.is_piped else given.source
    return run(
        source,
        outputs.folder,
        config=config,
        mode=given.mode,
        start=given.start,
        end=given.end,
        stride=given.stride,
        rrd=shown.rrd,
        exports=Exports(mcap=outputs.mcap, colmap=outputs.colmap, ply=outputs.ply),
        poses=poses,
        save_map=outputs.save_map,
        scale=ScaleOptions(*request.scale),
        rrd_images=shown.rrd_images,
        viewer=viewer,
        calibration=given.calibration,
        format=given.format,
        topics=given.topics,
        right_offset_ns=given.right_offset_ns,
        follow=given.follow or given.is_piped,
        side_by_side=given.side_by_side,
        timeout_s=given.timeout_s,
        duration_s=given.duration_s,
        record=given.record,
        source_name=NAME if given.is_piped else None,
        progress=progress,
        profile_since=outputs.profile_since,
        optimizer_process=optimizer_process,
    )


def _pose_targets(outputs: Outputs, stack: ExitStack) -> list[str | PoseSink]:
    """Where to send poses; standard output is reserved for them if they are written there."""
    from vo.cli.reserved_output import reserved_standard_output
    from vo.outputs.streaming.json_lines import JsonLines

    if not outputs.poses_on_standard_output:
        return list(outputs.poses)
    lines = JsonLines(stack.enter_context(reserved_standard_output()))
    return [lines if address == "-" else address for address in outputs.poses]


def _is_terminal_for_poses(outputs: Outputs) -> bool:
    """Whether poses are written to a terminal, where a progress bar would be mixed with them."""
    is_open = sys.stdout is not None and not sys.stdout.closed
    return outputs.poses_on_standard_output and is_open and sys.stdout.isatty()
