"""Settings of runs that differ from the defaults."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from vo.base.config import Config
from vo.base.files.bounded_documents import load_yaml


def changed_settings(texts: Sequence[str], defaults: Config) -> dict[str, list[str]]:
    """Values of each run by `section.key`, for settings that differ from the default in any run.

    `texts`: `config.yaml` of each run; an invalid one has no values. `defaults`: the default
    settings.
    """
    default_values = dict(_flat(defaults.model_dump(mode="json")))
    found = [dict(_flat(_parsed(text))) for text in texts]
    names = [
        *default_values,
        *(name for each in found for name in each if name not in default_values),
    ]
    return {
        name: [str(each.get(name, "–")) for each in found]
        for name in dict.fromkeys(names)
        if any(name in each and each[name] != default_values.get(name) for each in found)
    }


def _parsed(text: str) -> dict[str, Any]:
    try:
        parsed = load_yaml(text)
    except ValueError:
        return {}
    return parsed if isinstance(parsed, dict) else {}


def _flat(values: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
