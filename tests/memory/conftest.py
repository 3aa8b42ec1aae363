"""Rendered recording that several tests of the memory use."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from room_course import END, run_rounds

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from data_synth.writers import euroc
from vo.types import Trajectory


@pytest.fixture(scope="session")
def rounds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A round and a half through a room at 10 Hz, as EuRoC, in images of 301 x 192."""
    settings = ["motion=loop", "seconds=40", "fps=10", "scale=0.4", "mono=true"]
    plan = make_plan(load_recipe("demo", settings))
    folder = tmp_path_factory.mktemp("rounds") / "room"
    taken = slice(END)
    recording = replace(
        plan.recording,
        stamps_ns=tuple(stamps[taken] for stamps in plan.recording.stamps_ns),
        dropped=tuple(dropped[taken] for dropped in plan.recording.dropped),
        cam0_truth=Trajectory(
            plan.recording.cam0_truth.stamps_ns[taken],
            plan.recording.cam0_truth.world_from_cam[taken],
        ),
    )
    with ThreadPoolExecutor() as pool:
        euroc.write(folder, recording, render_frames(plan, pool, range(END)), "png")
    return folder


@pytest.fixture(scope="session")
def closed(rounds: Path) -> Path:
    """Results of the rounds with loops; `room.map` and `room.rrd` are in the folder beside."""
    output, saved = rounds.parent / "closed", rounds.parent / "room.map"
    outputs = {"save_map": saved, "rrd": rounds.parent / "room.rrd", "rrd_images": "none"}
    run_rounds(rounds, output, "memory.loops=true", **outputs)
    return output
