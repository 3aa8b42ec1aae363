"""Settings: sections of validated values, merged from YAML files and overrides.

An unknown key is an error that suggests the most similar one.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from vo.base.errors import ConfigError
from vo.base.files.bounded_files import read_text
from vo.base.section import Section

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

_MAX_BYTES = 2**20
_WORD, _NUMBER = re.compile("[a-z_]+"), re.compile(r"-?\d+(\.\d+)?")
_VALUES = {"null", "true", "false", "yes", "no", "on", "off"}  # words that are no text
_S = TypeVar("_S", bound=Section)


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
    from vo.base.files.bounded_yaml import load_yaml

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
    from vo.base.files.bounded_yaml import load_yaml

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
    if not merged:
        return model()
    from pydantic import ValidationError

    try:
        return model.model_validate(merged)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            known = list(_keys(model()))
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


def as_yaml(section: Section) -> str:
    """All settings as YAML, as PyYAML writes them; it is loaded only where it is needed."""
    try:
        return "".join(_lines(section, ""))
    except ValueError:
        import yaml

        return yaml.safe_dump(section.model_dump(mode="json"), sort_keys=False)


def _lines(section: Section, indent: str) -> Iterator[str]:
    for name in section.names():
        value = getattr(section, name)
        if isinstance(value, Section):
            yield f"{indent}{name}:\n"
            yield from _lines(value, f"{indent}  ")
        else:
            yield f"{indent}{name}: {_plain(value)}\n"


def _plain(value: Any) -> str:
    """A value that YAML writes in one obvious way.

    Raises:
        ValueError: it is another one.
    """
    if value == "" or value == ():
        return "''" if value == "" else "[]"
    text = str(value)
    if value is None or isinstance(value, bool):
        return "null" if value is None else text.lower()
    is_word = isinstance(value, str) and _WORD.fullmatch(text) and text not in _VALUES
    if is_word or (isinstance(value, int | float) and _NUMBER.fullmatch(text)):
        return text
    raise ValueError(text)


def nearest(word: str, known: Sequence[str]) -> str:
    """A suggestion of the most similar known word, or an empty string."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.3)
    return f"; did you mean '{close[0]}'?" if close else ""


def _keys(section: Section, prefix: str = "") -> Iterator[str]:
    for name in section.names():
        yield prefix + name
        if isinstance(value := getattr(section, name), Section):
            yield from _keys(value, f"{prefix}{name}.")
