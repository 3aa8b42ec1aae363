"""The Typer application: user errors become one `error: …` line, bugs keep their traceback."""

from __future__ import annotations

import errno
import io
import os
import re
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from vo.base.errors import VoError
from vo.cli.batch import batch_command
from vo.cli.blocks import CommandFunction
from vo.cli.calibrate import calibrate_command
from vo.cli.command import Command
from vo.cli.compare import compare_command
from vo.cli.convert import convert_command
from vo.cli.demo import demo_command
from vo.cli.echo import echo
from vo.cli.eval import eval_command
from vo.cli.features import features_command
from vo.cli.flags import speak_as
from vo.cli.help_levels import FIRST_OPTIONS, help_all_option
from vo.cli.info import info_command
from vo.cli.map import map_command
from vo.cli.markers import markers_command
from vo.cli.match import match_command
from vo.cli.memory import memory_command
from vo.cli.models import models_command
from vo.cli.panorama import panorama_command
from vo.cli.recognize import recognize_command
from vo.cli.render import render_command
from vo.cli.report import report_command
from vo.cli.run import run_command
from vo.cli.sweep import sweep_command
from vo.cli.synth import synth_command
from vo.cli.video import video_command
from vo.cli.view import view_command
from vo.cli.vocabulary import vocabulary_command
from vo.cli.warmup import warmup_command

# Such as a number of a million digits in a damaged file.
_LONG_WORD = re.compile(r"(\S{200})\S{800,}")


class _Group(TyperGroup):
    """Prints a `VoError` or OSError of any command as one line and exits with status 1."""

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        if not ctx.resilient_parsing:  # of a line that the shell completes
            _refuse_empty_arguments(args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        _replace_unprintable_characters()
        try:
            return super().invoke(ctx)
        except VoError as error:
            echo(_LONG_WORD.sub(r"\1…", f"error: {error}"), err=True)
            raise typer.Exit(1) from error
        except OSError as error:
            if error.errno is None or error.errno == errno.EPIPE:  # a closed pipe is no error
                raise
            where = "standard output" if error.filename is None else error.filename
            echo(f"error: {where}: {error.strerror}", err=True)
            _discard_stdout()
            raise typer.Exit(1) from error


def _refuse_empty_arguments(arguments: list[str]) -> None:
    """Refuse empty arguments, which as paths would mean the current folder."""
    for number, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if argument.strip() and not (equals and name.startswith("--") and not value.strip()):
            continue
        option = name if equals else arguments[number - 1] if number else ""
        what = f"the value of {option}" if option.startswith("-") else "an argument"
        echo(f"error: {what} is empty; is a shell variable not set?", err=True)
        raise typer.Exit(2)


def _replace_unprintable_characters() -> None:
    """Print question marks for characters that the locale lacks, instead of raising an error."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _discard_stdout() -> None:
    """Discard buffered output, which could not be written at exit either."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError, AttributeError):  # closed, or not a file
        return


app = typer.Typer(
    cls=_Group,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(is_given: bool) -> None:
    if is_given:
        from vo.base.version import __version__

        echo(f"vo {__version__}")
        raise typer.Exit()


@app.callback()
def _vo(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Visual odometry: the trajectory of a camera, with its uncertainty, from images.

    Try it without a recording:

      vo demo

    Run it on a recording, evaluate the trajectory, and write a report:

      vo run my_sequence/ -o out/
      vo eval out/ my_sequence/
      vo report out/
    """


_COMMANDS: dict[str, dict[str, Callable[..., None]]] = {
    "Start here": {
        "demo": demo_command,
        "info": info_command,
        "run": run_command,
    },
    "Results": {
        "view": view_command,
        "eval": eval_command,
        "report": report_command,
        "compare": compare_command,
        "map": map_command,
        "render": render_command,
        "video": video_command,
    },
    "Recordings and cameras": {
        "calibrate": calibrate_command,
        "convert": convert_command,
        "synth": synth_command,
        "batch": batch_command,
        "sweep": sweep_command,
        "warmup": warmup_command,
    },
    "Features, markers and objects": {
        "match": match_command,
        "features": features_command,
        "panorama": panorama_command,
        "markers": markers_command,
        "recognize": recognize_command,
        "models": models_command,
        "vocabulary": vocabulary_command,
        "memory": memory_command,
    },
}
"""Commands below their headings in `vo --help`."""
speak_as(CommandFunction(run_command))
for _heading, _functions in _COMMANDS.items():
    for _name, _function in _functions.items():
        _extra = (help_all_option(),) if _name in FIRST_OPTIONS else ()
        _given = CommandFunction(_function, *_extra)
        app.command(_name, cls=Command, rich_help_panel=_heading)(_given)


def keep_only(arguments: list[str]) -> None:
    """Remove all commands but the given one, as Typer would prepare all of them."""
    given = [command for command in app.registered_commands if [command.name] == arguments]
    if given:
        app.registered_commands = given
