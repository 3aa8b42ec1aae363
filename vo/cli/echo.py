"""Plain output: text from files appears without control characters."""

from __future__ import annotations

import json
from typing import Any

import typer

from vo.base.printable import printable


def echo(text: str, *, err: bool = False) -> None:
    """Print a line on standard output, or on standard error."""
    typer.echo(printable(text), err=err)


def echo_json(value: Any) -> None:
    """Print a value as JSON, in which control characters are escaped."""
    text = json.dumps(value, indent=2, allow_nan=False)
    typer.echo(text.replace("\x7f", "\\u007f"))  # the only one that `json` leaves
