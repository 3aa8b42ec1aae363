"""The worlds by name."""

from __future__ import annotations

from importlib import import_module
from typing import cast

from data_synth.scene.scene import Scene

WORLDS: dict[str, str] = {
    "room": "data_synth.worlds.room",
    "corridor": "data_synth.worlds.corridor",
    "white_corridor": "data_synth.worlds.white_corridor",
    "street": "data_synth.worlds.street",
    "warehouse": "data_synth.worlds.warehouse",
    "terrain": "data_synth.worlds.terrain",
}


def make_scene(name: str, seed: int, movers: float = 0.0, session: int = 0) -> Scene:
    """Build a world; each module has `make_scene(seed, movers, session)`.

    `movers`: number of moving bodies relative to the usual one; 0 for none. `session`: the solids
    do not depend on it, but the light does.
    """
    return cast(Scene, import_module(WORLDS[name]).make_scene(seed, movers, session))
