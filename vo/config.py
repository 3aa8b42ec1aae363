"""Settings: one frozen section per room, merged from defaults, a YAML file and overrides.

Precedence, weakest first: the defaults below, the preset or file, the overrides
(`section.key=value`). A key that does not exist is an error that names the nearest one.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vo.errors import ConfigError


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class FeaturesConfig(_Section):
    """ORB features, spread over the image by a grid."""

    count: int = Field(1500, ge=50, le=20000, description="features per image")


class Config(_Section):
    """All settings of a run."""

    seed: int = Field(0, ge=0, description="seed of every random choice")
    features: FeaturesConfig = FeaturesConfig()


def preset_names() -> list[str]:
    """Names of the presets that come with the package."""
    return sorted(p.stem for p in _preset_folder().glob("*.yaml"))


def load_config(config: str | Path = "default", overrides: Sequence[str] = ()) -> Config:
    """Merge defaults, a preset or YAML file, and overrides.

    Args:
        config: name of a preset, or path of a YAML file.
        overrides: texts of the form `section.key=value`; the value is read as YAML.

    Raises:
        ConfigError: unknown preset, file or key, or a value of the wrong type or range.
    """
    merged = _read_yaml(_find(config))
    for text in overrides:
        _set(merged, text)
    return _validate(merged, str(config))


def dump_config(config: Config) -> str:
    """The merged settings as YAML that `load_config` reads back."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)


def _preset_folder() -> Path:
    installed = Path(__file__).parent / "configs"
    return installed if installed.is_dir() else Path(__file__).parent.parent / "configs"


def _find(config: str | Path) -> Path:
    path = Path(config)
    if path.suffix in {".yaml", ".yml"} or path.is_file():
        if not path.is_file():
            raise ConfigError(f"config file {path} does not exist")
        return path
    preset = _preset_folder() / f"{config}.yaml"
    if not preset.is_file():
        raise ConfigError(
            f"no preset named '{config}'{_nearest(str(config), preset_names())}; "
            f"give one of {', '.join(preset_names())} or the path of a YAML file"
        )
    return preset


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read config {path}: {' '.join(str(error).split())}") from error
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError(f"config {path} is not a mapping of sections but {type(data).__name__}")
    return data


def _set(merged: dict[str, Any], text: str) -> None:
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


def _validate(merged: Mapping[str, Any], origin: str) -> Config:
    try:
        return Config.model_validate(merged)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            known = list(_keys(Config))
            raise ConfigError(
                f"unknown setting '{key}' in {origin}{_nearest(key, known)}"
            ) from error
        raise ConfigError(
            f"setting '{key}' in {origin}: {first['msg']} (found {first['input']!r})"
        ) from error


def _keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, info in model.model_fields.items():
        yield prefix + name
        if isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel):
            yield from _keys(info.annotation, f"{prefix}{name}.")


def _nearest(word: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.3)
    return f"; did you mean '{close[0]}'?" if close else ""
