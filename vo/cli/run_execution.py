"""Execution of `vo run`: start-up, progress, the run itself, its summary and exit status."""

from __future__ import annotations

import logging
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from functools import cache
from typing import TYPE_CHECKING, Any

import typer

from vo.base.scheduling import share_one_heap
from vo.cli.echo import echo, echo_error
from vo.cli.flags import given_words, known_flags
from vo.cli.garbage import collection_paused
from vo.cli.messages import warnings_on
from vo.cli.run_options import Outputs
from vo.cli.stopping import IgnoringAtEnd, stop_signals_as_interrupts

if TYPE_CHECKING:
    from rich.console import Console

    from vo.base.config import Config
    from vo.cli.run import RunRequest
    from vo.outputs.results.summary import Summary
    from vo.outputs.streaming.sink import PoseSink
    from vo.runs.progress import Progress

NO_PATH, UNDER_SHARE = 3, 4
"""Exit status without any pose, and where `--fail-under` is not reached."""

_SHARE = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(%?)")


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
            config = _settings(request)
            import vo.runs.run_recording  # noqa: F401 - loading it collects no garbage
        share_one_heap()
        errors = cache(_standard_error)  # for the first line
        stack.enter_context(warnings_on(None if quiet else errors, quiet=quiet))
        is_quiet = quiet or _is_terminal_for_poses(request.outputs)
        progress = _progress(errors, quiet=is_quiet)
        options = {
            "progress": IgnoringAtEnd(progress, signals),
            "profile_since": begun if request.outputs.profile else None,
            "flags": known_flags(),
        }
        summary = _run(request, config, options, stack)
        _print_result(summary, request, errors)
        if request.outputs.dense and summary.tracked:
            _make_dense(request)
        if request.viewer.serve:
            signals.obey()  # one of them ends the viewer
    exit_if_insufficient(summary, min_share)


def _process_start() -> float:
    """Start of this process on the clock of `time.perf_counter`."""
    from vo.outputs.results.environment import process_age_s

    return time.perf_counter() - (process_age_s() or 0.0)


def _standard_error() -> Console:
    from vo.cli.console import standard_error

    return standard_error()


def _progress(errors: Callable[[], Console], *, quiet: bool) -> Progress:
    from vo.runs.progress import NullProgress

    if quiet:
        return NullProgress()
    from vo.cli.progress import make_progress

    return make_progress(errors())


def _print_result(summary: Summary, request: RunRequest, errors: Callable[[], Console]) -> None:
    """Print the summary as text or JSON; warnings apart from a text."""
    printing = request.printing
    if printing.json_output or not printing.quiet:
        _print_summary(summary, request, errors)
    if printing.json_output or printing.quiet:
        for warning in summary.closing_warnings:
            echo_error(f"warning: {warning}")


def _print_summary(summary: Summary, request: RunRequest, errors: Callable[[], Console]) -> None:
    from vo.cli.console import standard_output
    from vo.cli.run_table import WrittenFiles, print_summary

    outputs, printing = request.outputs, request.printing
    others = {
        "recording": request.viewer.rrd,
        **outputs.exports.files,
        "raw frames": request.live.record,
        "map": outputs.save_map,
        "calibration": outputs.save_calibration,
    }
    files = WrittenFiles.of(request.output, others)
    record = {"output": str(request.output), "files": [str(path) for path in files.paths]}
    console = errors() if outputs.poses_on_standard_output else standard_output()
    same = (request.reading, request.frames, request.masks, request.settings, request.scale)
    options = given_words(*same)
    printing.show(
        lambda: {**summary.to_dict(), **record},
        lambda: print_summary(summary, files, console, options),
    )


def _make_dense(request: RunRequest) -> None:
    """Do what `vo dense` does with the run."""
    from vo.cli.dense import densify_with_progress, print_dense
    from vo.tools.dense.fusion import DenseOptions

    printing = request.printing
    done = densify_with_progress(request.output, None, None, DenseOptions(), printing)
    if not (printing.json_output or printing.quiet or request.outputs.poses_on_standard_output):
        print_dense(done)


def _settings(request: RunRequest) -> Config:
    """Load the settings; warnings about them come before the console of the other ones is there."""
    from vo.base.config import load_config

    if logging.lastResort is not None:
        logging.lastResort.setFormatter(logging.Formatter("warning: %(message)s"))
    settings = request.settings
    return load_config(settings.config, [*settings.all, *request.masks.settings])


def _run(request: RunRequest, config: Config, options: dict[str, Any], stack: ExitStack) -> Summary:
    from vo.cli.standard_input import NAME, spooled_input
    from vo.runs.run_recording import run

    shown, live, outputs, is_piped = request.viewer, request.live, request.outputs, request.is_piped
    poses = _pose_targets(outputs, stack)
    viewer = stack.enter_context(_live_viewer(shown.connect, spawn=shown.spawn, serve=shown.serve))
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
        allow_hosts=live.allow_host or (),
        record=live.record,
        source_name=NAME if is_piped else None,
        scale=request.scale.sources,
        rrd=shown.rrd,
        rrd_images=shown.rrd_images.value,
        viewer=viewer,
        exports=outputs.exports,
        poses=poses,
        allow_origins=outputs.allow_origin or (),
        save_map=outputs.save_map,
        save_calibration=outputs.save_calibration,
        **options,
    )


def _pose_targets(outputs: Outputs, stack: ExitStack) -> list[str | PoseSink]:
    """Where to send poses; standard output is reserved for them if they are written there."""
    given = outputs.poses or []
    if not outputs.poses_on_standard_output:
        return list(given)
    from vo.cli.reserved_output import reserved_standard_output
    from vo.outputs.streaming.json_lines import JsonLines

    lines = JsonLines(stack.enter_context(reserved_standard_output()))
    return [lines if address == "-" else address for address in given]


def _is_terminal_for_poses(outputs: Outputs) -> bool:
    """Whether poses are written to a terminal, where a progress bar would be mixed with them."""
    is_open = sys.stdout is not None and not sys.stdout.closed
    return outputs.poses_on_standard_output and is_open and sys.stdout.isatty()


@contextmanager
def _live_viewer(connect: str | None, *, spawn: bool, serve: bool) -> Iterator[str | None]:
    """URL of the viewer to stream to, or None. A served page is kept open until Ctrl-C.

    Raises:
        OutputError: there is no such viewer, or it cannot be started.
        typer.BadParameter: more than one viewer is given.
    """
    if sum((connect is not None, spawn, serve)) > 1:
        raise typer.BadParameter("use only one of --connect, --spawn and --serve")
    if connect is None and not spawn and not serve:
        yield None
        return
    from vo.outputs.recorders.viewer import check_viewer, start_native, start_web, viewer_url

    if connect is not None:
        url = viewer_url(connect)
        check_viewer(url)
        yield url
    elif spawn:
        yield start_native().url
    else:
        viewer = start_web()
        try:
            echo(f"viewer at {viewer.page}", err=True)
            yield viewer.url
            echo(f"viewer still at {viewer.page}; press Ctrl-C to end", err=True)
            with suppress(KeyboardInterrupt):
                viewer.wait()
        finally:
            viewer.stop()


def parse_share(text: str) -> float:
    """The value of `--fail-under` as a fraction: `90%` or `0.9`.

    Raises:
        typer.BadParameter: it is no share from 0 to 100 %.
    """
    found = _SHARE.fullmatch(text.strip())
    value = float(found[1]) / (100.0 if found[2] else 1.0) if found else -1.0
    if not 0.0 <= value <= 1.0:
        raise typer.BadParameter(
            f"{text} is not a share of the frames; give for example 90% or 0.9",
            param_hint="--fail-under",
        )
    return value


def exit_if_insufficient(summary: Summary, min_share: float | None) -> None:
    """End the command with the status of a run that has no path, or not the one required.

    Raises:
        typer.Exit: with `NO_PATH` or `UNDER_SHARE`.
    """
    posed = summary.tracked + summary.interpolated
    if not posed:
        raise typer.Exit(NO_PATH)
    if min_share is None:
        return
    if posed < min_share * summary.frames:
        found = f"{posed} of {summary.frames} frames have a pose ({posed / summary.frames:.1%})"
        echo(f"error: {found}, --fail-under asks for {min_share:.4g}", err=True)
    elif not summary.verdict.is_trusted:
        echo("error: --fail-under: the path is not to be trusted, see the warnings", err=True)
    else:
        return
    raise typer.Exit(UNDER_SHARE)
