"""Two levels of help: `--help` has the options that a first user needs, `--help-all` the rest."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from inspect import Parameter
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from vo.cli.echo import echo

FIRST_OPTIONS: Mapping[str, str] = {
    "run": "--output --calibration --mode --start --end --config --gps --rrd",
    "batch": "--output --calibration --mode --config --set --jobs --report",
    "sweep": "--output --try --trials --held-out --config --jobs",
    "calibrate": "--output --board --columns --rows --square --marker --model --imu",
    "synth": "--preset --world --motion --camera --mono --seconds --to --force",
    "convert": "--to --start --end --stride --resize --calibration --force",
    "dense": "--output --edge --far --no-mesh --cloud --nerfstudio --rrd",
    "features": "--detector --descriptor --compare --calibration --frame --picture",
    "match": "--output --pairs --calibration --detector --matcher --model --picture --best",
    "recognize": "--database --width --min-confidence --calibration --picture",
    "markers": "--length --dictionary --board --calibration --print --ids --picture --csv",
}
"""Options in the first level of each command that has two."""

_FURTHER = "\n\nFurther examples"  # a heading in docstrings; it and what follows: second level
_ALL = "vo.help_all"


def help_all_option() -> Parameter:
    """The option `--help-all`, for the signature of a command."""
    given = typer.Option(
        "--help-all", callback=_print_all, is_eager=True, help="Show all options and examples."
    )
    kind = Parameter.KEYWORD_ONLY
    return Parameter("help_all", kind, default=False, annotation=Annotated[bool, given])


def _print_all(ctx: typer.Context, is_given: bool) -> None:
    if is_given and not ctx.resilient_parsing:
        ctx.meta[_ALL] = True
        echo(ctx.get_help())
        raise typer.Exit()


def first_level(command: TyperCommand, ctx: Any) -> TyperCommand:
    """The command as `--help` shows it: itself, if it has one level or all are asked for."""
    names = FIRST_OPTIONS.get(command.name or "", "").split()
    if not names or ctx.meta.get(_ALL):
        return command
    short = copy.copy(command)
    by_name = {parameter.opts[0]: parameter for parameter in command.params}
    arguments = [each for each in command.params if each.param_type_name == "argument"]
    shown = [*arguments, *(by_name[name] for name in (*names, "--help-all"))]
    short.params = [copy.copy(parameter) for parameter in shown]
    for parameter in short.params:
        parameter.rich_help_panel = None  # type: ignore[attr-defined]  # one panel for all
    short.help = (command.help or "").partition(_FURTHER)[0]
    left_out = len(command.params) - len(short.params)
    short.epilog = f"{left_out} more options, in groups: vo {command.name} --help-all"
    return short
