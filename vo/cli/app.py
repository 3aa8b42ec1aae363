"""The Typer application: user errors become one `error: …` line, bugs keep their traceback."""

from __future__ import annotations

import errno
import io
import os
import re
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from vo.base.errors import VoError
from vo.cli.blocks import CommandFunction
from vo.cli.command import Command
from vo.cli.echo import echo
from vo.cli.flags import speak_as
from vo.cli.help_levels import FIRST_OPTIONS, help_all_option
from vo.cli.plain_values import read_plainly

# Such as a number of a million digits in a damaged file.
_LONG_WORD = re.compile(r"(\S{200})\S{800,}")


class _Group(TyperGroup):
    """Prints a `VoError` or OSError of any command as one line and exits with status 1."""

    def get_params(self, ctx: Any) -> Any:
        return read_plainly(super().get_params(ctx))

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


_app = typer.Typer(
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


@_app.callback()
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


COMMANDS = {
    "Start here": ("demo", "info", "run"),
    "Results": ("view", "eval", "report", "compare", "map", "render", "video", "dense", "export"),
    "Recordings and cameras": ("calibrate", "convert", "synth", "batch", "sweep", "warmup"),
    "Features, markers and objects": (
        *("match", "features", "panorama", "markers", "recognize", "models", "vocabulary"),
        "memory",
    ),
}
"""Commands below their headings in `vo --help`."""


def command_function(name: str) -> Callable[..., None]:
    """The function of a command, `run_command` in the module `run` for `run`."""
    function: Callable[..., None] = getattr(import_module(f"vo.cli.{name}"), f"{name}_command")
    return function


def command_line(arguments: Sequence[str] = ()) -> typer.Typer:
    """The application with the command that the arguments begin with, or with all commands.

    Loading and preparing all of them takes a tenth of a second.
    """
    given = [name for names in COMMANDS.values() for name in names if [name] == [*arguments[:1]]]
    _app.registered_commands = []
    for heading, names in COMMANDS.items():
        for name in names:
            if name in given or not given:
                extra = (help_all_option(),) if name in FIRST_OPTIONS else ()
                function = CommandFunction(command_function(name), *extra)
                _app.command(name, cls=Command, rich_help_panel=heading)(function)
    return _app


def __getattr__(name: str) -> Any:
    """`app` is the application with all commands."""
    if name == "app":
        return command_line()
    raise AttributeError(name)


speak_as(CommandFunction(command_function("run")))
