"""Writes configs/*.yaml from the settings in vo/base/config.py, every key with a comment.

Run it after a change of a setting or a preset; a test checks that the files are up to date.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from pydantic.fields import FieldInfo

from vo.base.config import Config
from vo.base.section import Section
from vo.base.settings import is_expert

FOLDER = Path(__file__).resolve().parent.parent / "configs"

TITLES = {
    "default": "The defaults of `vo run`. Your own file needs only the keys that it changes:\n"
    "# `vo run … --config mine.yaml`.",
    "fast": "For speed: fewer features and landmarks, a smaller window.",
    "accurate": "For accuracy: more features and landmarks, a larger window.",
    "best": "Offline, for the most accurate path: an adjustment of the whole path at the end.",
}
CHANGES: dict[str, dict[str, Any]] = {
    "default": {},
    "fast": {
        "features.count": 800,
        "tracking.max_landmarks": 500,
        "mapping.new_per_keyframe": 350,
        "mapping.fuse_keyframes": 3,
        "mapping.neighbours": 3,
        "smoothing.window": 5,
        "smoothing.fixed": 3,
        "keyframes.min_tracked_ratio": 0.65,
        "keyframes.min_tracked": 120,
        "keyframes.min_tracked_mono": 80,
        "keyframes.min_parallax_deg": 1.5,
        "smoothing.max_landmarks": 300,
        "smoothing.iterations": 5,
    },
    "best": {"patches.half_px": 4, "refinement.rounds": 3},
    "accurate": {
        "features.count": 3000,
        "tracking.max_landmarks": 2000,
        "keyframes.min_parallax_deg": 1.5,
        "mapping.new_per_keyframe": 1200,
        "smoothing.window": 8,
        "smoothing.fixed": 16,
        "smoothing.max_landmarks": 1600,
    },
}
BOUNDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}


def render(preset: str) -> str:
    """The text of a preset.

    Raises:
        KeyError: the preset changes a setting that does not exist.
    """
    changes = dict(CHANGES[preset])
    lines = [f"# {TITLES[preset]}", "", *_lines(Config, "", changes)]
    if changes:
        raise KeyError(f"preset {preset} changes settings that do not exist: {list(changes)}")
    return "\n".join(lines) + "\n"


def _lines(model: type[Section], section: str, changes: dict[str, Any]) -> Iterator[str]:
    indent = "  " if section else ""
    fields = sorted(model.model_fields.items(), key=lambda field: is_expert(field[1]))
    has_expert_line = False
    for name, info in fields:
        if isinstance(info.default, Section):
            yield from ("", f"# {_one_line(info.default.__doc__)}", f"{name}:")
            yield from _lines(type(info.default), f"{name}.", changes)
            continue
        if is_expert(info) and not has_expert_line:
            has_expert_line = True
            yield f"{indent}# Expert settings"
        value = changes.pop(section + name, info.default)
        note = f"; default {_yaml(info.default)}" if value != info.default else ""
        comment = f"{info.description}{_range(info)}{note}"
        yield f"{indent}{name}: {_yaml(value)}  # {comment}"


def _range(info: FieldInfo) -> str:
    found = {key: getattr(m, key) for m in info.metadata for key in BOUNDS if hasattr(m, key)}
    words = [f"{BOUNDS[key]} {bound:g}" for key, bound in found.items()]
    return f" ({', '.join(words)})" if words else ""


def _yaml(value: Any) -> str:
    return yaml.safe_dump(value).removesuffix("\n").removesuffix("\n...")


def _one_line(text: str | None) -> str:
    return " ".join((text or "").split())


if __name__ == "__main__":
    for name in TITLES:
        (FOLDER / f"{name}.yaml").write_text(render(name), encoding="utf-8")
