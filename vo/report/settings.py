"""Which settings of a run differ from the defaults."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import yaml

from vo.config import Config


def changed_settings(texts: Sequence[str], defaults: Config) -> dict[str, list[str]]:
    """Values of each run by `section.key`, for settings where one of them is not the default.

    Args:
        texts: `config.yaml` of each run; one that cannot be read has no values.
        defaults: what counts as not changed.
    """
    usual = dict(_flat(defaults.model_dump(mode="json")))
    found = [dict(_flat(_parsed(text))) for text in texts]
    names = [*usual, *(name for each in found for name in each if name not in usual)]
    return {
        name: [str(each.get(name, "–")) for each in found]
        for name in dict.fromkeys(names)
        if any(name in each and each[name] != usual.get(name) for each in found)
    }


def _parsed(text: str) -> dict[str, Any]:
    try:
        parsed = yaml.safe_load(text)
    except yaml.YAMLError:
        return {}
    return parsed if isinstance(parsed, dict) else {}


def _flat(values: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
