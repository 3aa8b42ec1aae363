"""World: the office corridor with white walls, without doors, boards and any mark."""

from __future__ import annotations

from data_synth.scene.scene import Scene
from data_synth.worlds import corridor


def make_scene(seed: int, movers: float = 0.0, session: int = 0) -> Scene:
    """The corridor of the seed; floor, ceiling and lamps have their structure."""
    return corridor.make_scene(seed, movers, session, white=True)
