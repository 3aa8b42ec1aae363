"""What all commands have in common: names of options in the release before are understood."""

from __future__ import annotations

import inspect
import logging
from contextlib import nullcontext
from typing import Any

import typer
from typer.core import TyperCommand

from vo.cli.blocks import CommandFunction
from vo.cli.completion import OUTPUT_FORMATS
from vo.cli.echo import echo
from vo.cli.flags import speak_as
from vo.cli.heartbeat import heartbeat
from vo.cli.help_levels import first_level
from vo.cli.plain_values import read_plainly

_RENAMED = {
    "convert": {"--source-format": "--format"},
    "eval": {"--plot": "--picture"},
    "info": {"--contact-sheet": "--picture"},
    "report": {"--plots": "--picture"},
    "synth": {"--format": "--to"},
}

_WITH_LINES = ("run", "batch", "sweep", "view")  # these print lines of their own, or wait


class Command(TyperCommand):
    """A command that understands options of the release before, and `--verbose`."""

    def get_params(self, ctx: Any) -> Any:
        """The arguments and options."""
        return read_plainly(super().get_params(ctx))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments after the name of the command."""
        function = None if self.callback is None else inspect.unwrap(self.callback)
        if isinstance(function, CommandFunction):
            speak_as(function)
        if not ctx.resilient_parsing:  # of a line that the shell completes
            args = with_new_names(self.name or "", args)
        try:
            rest = super().parse_args(ctx, args)
        except typer.BadParameter as error:  # without the words of the library that found it
            error.message = error.message.removeprefix("Value error, ")
            raise
        if ctx.params.get("quiet") and ctx.params.get("verbose"):
            raise typer.BadParameter("use only one of --quiet and --verbose")
        return rest

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help, or its first level."""
        TyperCommand.format_help(first_level(self, ctx), ctx, formatter)

    def invoke(self, ctx: Any) -> Any:
        """Execute the command; with --verbose, loggers of the library let all messages pass."""
        logger = logging.getLogger("vo")
        level = logger.level
        if ctx.params.get("verbose"):
            logger.setLevel(logging.DEBUG)
        is_silent = ctx.params.get("quiet") or self.name in _WITH_LINES
        try:
            with nullcontext() if is_silent else heartbeat(self.name or ""):
                return super().invoke(ctx)
        finally:
            logger.setLevel(level)


def with_new_names(command: str, arguments: list[str]) -> list[str]:
    """The arguments of a command with the present names of options; prints what was renamed."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    words, rest = arguments[:end], arguments[end:]
    if command == "convert" and not any(_name(word) == "--to" for word in words):
        words = _with_output_format(words)
    renamed = _RENAMED.get(command, {})
    return [_replaced(word, renamed) for word in words] + rest


def _replaced(word: str, renamed: dict[str, str]) -> str:
    old = _name(word)
    if old not in renamed:
        return word
    echo(f"note: {old} is now {renamed[old]}", err=True)
    return renamed[old] + word.removeprefix(old)


def _with_output_format(words: list[str]) -> list[str]:
    """Replace `--format` by `--to` where it names a format that can be written.

    Without `--to`, that is what it meant in the release before.
    """
    words = list(words)
    for number, word in enumerate(words):
        name, equals, value = word.partition("=")
        if name != "--format":
            continue
        if not equals:
            value = words[number + 1] if number + 1 < len(words) else ""
        if value in OUTPUT_FORMATS:
            words[number] = "--to" + word.removeprefix("--format")
            echo(
                f"note: the format to write is now --to {value}; --format is that of the recording",
                err=True,
            )
    return words


def _name(word: str) -> str:
    return word.partition("=")[0]
