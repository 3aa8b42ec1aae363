"""Settings: sections of validated values, merged from YAML files and overrides.

An unknown key is an error that suggests the most similar one.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from vo.base.errors import ConfigError
from vo.base.files.bounded_documents import load_yaml
from vo.base.files.bounded_files import read_text

_MAX_BYTES = 2**20


class Section(BaseModel):
    """A group of settings; unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")


_S = TypeVar("_S", bound=Section)


def expert(default: Any, **options: Any) -> Any:
    """A pydantic `Field` marked as a setting for experts."""
    return Field(default, json_schema_extra={"expert": True}, **options)


def is_expert(info: FieldInfo) -> bool:
    """Whether a setting is marked as one for experts."""
    extra = info.json_schema_extra
    return isinstance(extra, dict) and extra.get("expert") is True


def preset_folder() -> Path:
    """Folder of the presets in the package."""
    package = Path(__file__).parents[1]
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def find_preset(name: str | Path, folder: Path, what: str = "preset") -> Path:
    """Path of a preset given by name, or of a YAML file given by path.

    Raises:
        ConfigError: there is no such preset or file.
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
            f"no {what} named '{name}'; use one of {', '.join(known)}, or the path of a YAML file"
            f"{nearest(str(name), known)}"
        )
    return found


def names_in(folder: Path) -> list[str]:
    """Names of all presets in a folder."""
    return sorted(p.stem for p in folder.glob("*.yaml"))


def read_settings(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file.

    Raises:
        ConfigError: it cannot be read, or contains no mapping.
    """
    try:
        data = load_yaml(read_text(path, _MAX_BYTES))
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot read config {path}: {' '.join(str(error).split())}") from error
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError(
            f"config {path} contains {type(data).__name__}, not a mapping of sections to settings"
        )
    return data


def set_value(merged: dict[str, Any], text: str) -> None:
    """Apply an override `section.key=value`, with its value read as YAML.

    Raises:
        ConfigError: the text has another form.
    """
    key, separator, value = text.partition("=")
    if not separator or not key.strip():
        raise ConfigError(f"invalid setting '{text}'; use section.key=value")
    try:
        parsed = load_yaml(value)
    except ValueError as error:
        raise ConfigError(f"invalid value in '{text}'; it must be YAML") from error
    *sections, name = key.strip().split(".")
    node = merged
    for section in sections:
        child = node.setdefault(section, {})
        if not isinstance(child, dict):
            raise ConfigError(f"'{key}': '{section}' is not a section")
        node = child
    node[name] = parsed


def replace_old_names(merged: dict[str, Any], renamed: Mapping[str, str]) -> dict[str, str]:
    """Move values of settings that have been renamed to their new names, in place.

    Args:
        merged: values by section and key.
        renamed: new names by old names, both `section.key`.

    Returns:
        The old names that were used, with their new names.
    """
    used = {}
    for old, new in renamed.items():
        (old_section, old_key), (section, key) = old.split("."), new.split(".")
        values = merged.get(old_section)
        if not isinstance(values, dict) or old_key not in values:
            continue
        value = values.pop(old_key)
        target = merged.setdefault(section, {})
        if isinstance(target, dict):
            target[key] = value
        used[old] = new
    return used


def validate(
    model: type[_S],
    merged: Mapping[str, Any],
    origin: str,
) -> _S:
    """Validate merged settings.

    Args:
        model: the sections to fill.
        merged: values by section and key.
        origin: name of the file or preset, for messages.

    Raises:
        ConfigError: unknown key, or a value of the wrong type or out of range.
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
        reason = first["msg"]
        if first["type"] == "value_error":  # of a validator of ours, which says what was found
            raise ConfigError(
                f"setting '{key}' in {origin}: {reason.removeprefix('Value error, ')}"
            ) from error
        raise ConfigError(
            f"setting '{key}' in {origin}: {reason} (found {first['input']!r})"
        ) from error


def nearest(word: str, known: Sequence[str]) -> str:
    """A suggestion of the most similar known word, or an empty string."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.3)
    return f"; did you mean '{close[0]}'?" if close else ""


def _keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, info in model.model_fields.items():
        yield prefix + name
        if isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel):
            yield from _keys(info.annotation, f"{prefix}{name}.")
