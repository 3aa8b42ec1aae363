"""Rendered recording that several tests of the memory use."""

from __future__ import annotations

import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from marker_views import Placed, render
from room_course import BLACK, CHANGED, DICTIONARY, END, LENGTH_M, run_rounds

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from data_synth.writers import euroc
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Trajectory
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.registry import open_source


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


@pytest.fixture(scope="session")
def changed_room(rounds: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rounds, with a marker; the camera is covered, and then sees everything in negative."""
    folder = tmp_path_factory.mktemp("changed") / "room"
    shutil.copytree(rounds, folder)
    camera = open_source(rounds, mode="mono").rig.cam0
    truth = read_tum(rounds / "groundtruth.tum")
    angle = 0.75 * np.pi
    side = np.array([np.cos(angle), np.sin(angle), 0.0])
    facing = np.column_stack([[-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0], -side])
    facing[:, 0] = np.cross(facing[:, 1], facing[:, 2])
    world_from_marker = make_transform(facing, 2.2 * side + [0.0, 0.0, 1.55])
    files = sorted((folder / "mav0" / "cam0" / "data").glob("*.png"))
    for n, (path, world_from_cam) in enumerate(zip(files, truth.world_from_cam, strict=True)):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        image = image if n < BLACK else 255 - image if n >= CHANGED else np.zeros_like(image)
        pose = inverse(world_from_cam) @ world_from_marker
        is_seen = pose[2, 3] > 0.4 and pose[:3, 2] @ pose[:3, 3] < -0.05
        if is_seen and not BLACK <= n < CHANGED:
            levels = render(camera, Placed(DICTIONARY, 7, LENGTH_M, pose), image)
            blurred = cv2.GaussianBlur(levels, (0, 0), 0.5)
            image = np.clip(np.rint(blurred), 0, 255).astype(np.uint8)
        cv2.imwrite(str(path), image)
    return folder
