"""Exit status of `vo run`: whether there is a path, and whether it is as complete as required."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import typer

from vo.cli.echo import echo

if TYPE_CHECKING:
    from vo.outputs.results.summary import Summary

NO_PATH, UNDER_SHARE = 3, 4
"""Exit status without any pose, and where `--fail-under` is not reached."""

_SHARE = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(%?)")


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
