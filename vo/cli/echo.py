"""Plain output: options appear as flags, and text from files without control characters."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Any

import typer

from vo.base.printable import printable
from vo.cli.flags import in_flags
from vo.cli.heartbeat import said


def echo(text: str, *, err: bool = False) -> None:
    """Print a line on standard output, or on standard error."""
    said()
    typer.echo(printable(in_flags(text)), err=err)


def echo_error(text: str) -> None:
    """Print a line on standard error; a closed pipe or a full disk is ignored."""
    with suppress(OSError):
        echo(text, err=True)


def echo_json(value: Any) -> None:
    """Print a value as JSON, in which control characters are escaped."""
    text = json.dumps(in_flags(value), indent=2, allow_nan=False)
    typer.echo(text.replace("\x7f", "\\u007f"))  # the only one that `json` leaves
