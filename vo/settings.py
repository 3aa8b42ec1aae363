"""Reads settings: sections of checked values, merged from YAML and overrides.

A key that does not exist is an error that names the nearest one.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from vo.errors import ConfigError


class Section(BaseModel):
    """A group of settings; what it does not know is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


_S = TypeVar("_S", bound=Section)


def preset_folder() -> Path:
    """The presets that come with the package."""
    installed = Path(__file__).parent / "configs"
    return installed if installed.is_dir() else Path(__file__).parent.parent / "configs"


def find_preset(name: str | Path, folder: Path, what: str = "preset") -> Path:
    """The file of a preset by its name, or a YAML file by its path.

    Raises:
        ConfigError: there is none.
    """
    path = Path(name)
    if path.suffix in {".yaml", ".yml"} or path.is_file():
        if not path.is_file():
            raise ConfigError(f"{what} file {path} does not exist")
        return path
    found = folder / f"{name}.yaml"
    if not found.is_file():
        known = names_in(folder)
        raise ConfigError(
            f"no {what} named '{name}'{nearest(str(name), known)}; "
            f"give one of {', '.join(known)} or the path of a YAML file"
        )
    return found


def names_in(folder: Path) -> list[str]:
    """Names of the presets in a folder."""
    return sorted(p.stem for p in folder.glob("*.yaml"))


def read_settings(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file.

    Raises:
        ConfigError: it cannot be read or holds something else.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read config {path}: {' '.join(str(error).split())}") from error
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError(f"config {path} is not a mapping of sections but {type(data).__name__}")
    return data


def set_value(merged: dict[str, Any], text: str) -> None:
    """Take over `section.key=value`, its value read as YAML.

    Raises:
        ConfigError: the text is of another form.
    """
    key, separator, value = text.partition("=")
    if not separator or not key.strip():
        raise ConfigError(f"'{text}' is not of the form section.key=value")
    try:
        parsed = yaml.safe_load(value)
    except yaml.YAMLError as error:
        raise ConfigError(f"the value of '{text}' is not YAML") from error
    *sections, name = key.strip().split(".")
    node = merged
    for section in sections:
        child = node.setdefault(section, {})
        if not isinstance(child, dict):
            raise ConfigError(f"'{key}': '{section}' is not a section")
        node = child
    node[name] = parsed


def validate(model: type[_S], merged: Mapping[str, Any], origin: str) -> _S:
    """Settings as checked records.

    Raises:
        ConfigError: unknown key, or a value of the wrong type or range.
    """
    try:
        return model.model_validate(merged)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            known = list(_keys(model))
            raise ConfigError(
                f"unknown setting '{key}' in {origin}{nearest(key, known)}"
            ) from error
        raise ConfigError(
            f"setting '{key}' in {origin}: {first['msg']} (found {first['input']!r})"
        ) from error


def nearest(word: str, known: Sequence[str]) -> str:
    """A question that names the nearest known word, or nothing."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.3)
    return f"; did you mean '{close[0]}'?" if close else ""


def _keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, info in model.model_fields.items():
        yield prefix + name
        if isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel):
            yield from _keys(info.annotation, f"{prefix}{name}.")
