"""The Typer application: one `error: …` line for what a user can mend, a traceback for bugs."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from vo.cli.calibrate import calibrate_command
from vo.cli.convert import convert_command
from vo.cli.demo import demo_command
from vo.cli.eval import eval_command
from vo.cli.info import info_command
from vo.cli.report import report_command
from vo.cli.run import run_command
from vo.cli.synth import EPILOG, synth_command
from vo.cli.view import view_command
from vo.errors import VoError


class _Group(TyperGroup):
    """Turns a `VoError` of any command into one line on stderr and exit status 1.

    So it does with what the system refuses, such as standard output on a full disk.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        _refuse_empty_words(args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        _print_whatever_the_locale()
        try:
            return super().invoke(ctx)
        except VoError as error:
            typer.echo(f"error: {error}", err=True)
            raise typer.Exit(1) from error
        except OSError as error:
            if error.errno is None or error.errno == errno.EPIPE:  # a pipe that was closed is none
                raise
            where = "what is printed" if error.filename is None else error.filename
            typer.echo(f"error: {where}: {error.strerror}", err=True)
            _give_up_stdout()
            raise typer.Exit(1) from error


def _refuse_empty_words(words: list[str]) -> None:
    """As a path an empty word would be the current folder, which nobody means by it."""
    for number, word in enumerate(words):
        name, equals, value = word.partition("=")
        if word.strip() and not (equals and name.startswith("--") and not value.strip()):
            continue
        before = name if equals else words[number - 1] if number else ""
        what = f"what follows {before}" if before.startswith("-") else "an argument"
        typer.echo(f"error: {what} is empty; is a variable of the shell not set?", err=True)
        raise typer.Exit(2)


def _print_whatever_the_locale() -> None:
    """Where it knows ASCII only, other letters become question marks instead of an error."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _give_up_stdout() -> None:
    """What is still to be printed would fail again as the program ends."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError, AttributeError):  # it is closed already, or no file
        return


app = typer.Typer(
    cls=_Group,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Visual odometry: a camera's path, with its uncertainty, from images.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from vo import __version__

        typer.echo(f"vo {__version__}")
        raise typer.Exit()


@app.callback()
def _vo(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and stop."
        ),
    ] = False,
) -> None:
    """Keeps `vo` a group of commands even with one command."""


app.command("run")(run_command)
app.command("info")(info_command)
app.command("convert")(convert_command)
app.command("calibrate")(calibrate_command)
app.command("eval")(eval_command)
app.command("view")(view_command)
app.command("report")(report_command)
app.command("demo")(demo_command)
app.command("synth", epilog=EPILOG)(synth_command)


def keep_only(words: list[str]) -> None:
    """Of all commands leave the one that is called: Typer would make all of them ready."""
    called = [c for c in app.registered_commands if [c.name] == words]
    if called:
        app.registered_commands = called
