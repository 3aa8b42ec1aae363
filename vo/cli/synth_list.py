"""Output of `vo synth --list`: presets, cameras and settings."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from data_synth.cameras import camera_names, load_rig
from data_synth.recipe import Effects, ImuRecipe, Recipe, load_recipe, recipe_names
from vo.base.section import Section


def choices() -> dict[str, Any]:
    """Presets, cameras, and all settings with their defaults, for JSON."""
    return {
        "presets": {name: load_recipe(name).about for name in recipe_names()},
        "cameras": camera_names(),
        "settings": Recipe().model_dump(mode="json"),
    }


def print_choices(console: Console) -> None:
    """Print presets, cameras, and all settings with their defaults."""
    console.print(_presets())
    console.print(_cameras())
    for title, model, prefix in (
        ("Settings", Recipe, ""),
        ("Effects: 0 for none, 1 for the usual strength", Effects, "effects."),
        ("Inertial sensor", ImuRecipe, "imu."),
    ):
        console.print(_settings(title, model, prefix))


def _presets() -> Table:
    table = Table("preset", "world", "motion", "camera", "purpose", title="Presets", box=None)
    for name in recipe_names():
        recipe = load_recipe(name)
        table.add_row(name, recipe.world, recipe.motion, recipe.camera, recipe.about)
    return table


def _cameras() -> Table:
    table = Table("camera", "pixels", "lens", "cameras", title="Cameras", box=None)
    for name in camera_names():
        rig = load_rig(name)
        size = f"{rig.cam0.width} x {rig.cam0.height}"
        count = "1"
        if rig.further:
            count = str(len(rig.cameras))
        elif rig.cam1_from_cam0 is not None:
            count = f"2, {1e2 * float((rig.cam1_from_cam0[:3, 3] ** 2).sum()) ** 0.5:.0f} cm apart"
        table.add_row(name, size, rig.cam0.distortion_model, count)
    return table


def _settings(title: str, model: type[Section], prefix: str) -> Table:
    table = Table("setting", "default", "meaning", title=title, box=None)
    for name, info in model.model_fields.items():
        if isinstance(info.default, Section):
            continue
        choices = getattr(info.annotation, "__args__", ())
        meaning = (info.description or "") + (": " if choices else "")
        table.add_row(prefix + name, str(info.default), meaning + ", ".join(map(str, choices)))
    return table
