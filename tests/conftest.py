"""Fixtures for every room's tests."""

from __future__ import annotations

import gc
import os
import signal
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from vo.base.compiling.processor import use_common_instructions

# A job in the background of a shell has Ctrl-C ignored, and so would the programs tested here.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Before numpy is loaded, as the program does: other threads would only wait, on a busy core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# FFmpeg in OpenCV reads it once, with the first video of the process: as the package sets it.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
# A busy machine is no fault of a test.
settings.register_profile("any speed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any speed")
use_common_instructions()  # as the program does, so that both share what is compiled
gc.disable()  # while tests are collected, which all stay: to look through them takes 5 of 24 s


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the slowest files: in the end no process waits for another one's."""
    if hasattr(config, "workerinput"):
        slowest = Path(__file__).with_name("slowest_files.txt").read_text(encoding="utf-8").split()
        place = {name: n for n, name in enumerate(slowest)}
        tests = Counter(item.path for item in items)
        items.sort(
            key=lambda item: (place.get(item.path.stem, len(place)), -tests[item.path], item.path)
        )


@pytest.fixture(scope="session", autouse=True)
def _worlds_are_built_once() -> Iterator[None]:
    """Most renderings are of the same world, whose textures take longer than a few frames."""
    from data_synth import plan
    from data_synth.worlds.registry import make_scene

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "make_scene", lru_cache(maxsize=2)(make_scene))
        yield


@pytest.fixture(scope="session", autouse=True)
def _commands_are_built_once() -> Iterator[None]:
    """Of 26 commands a call needs one: to build them all takes longer than most of the calls."""
    from typer import testing

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(testing, "_get_command", lru_cache(testing._get_command))
        yield


@pytest.fixture(scope="session")
def synthetic_stereo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Thirty stereo frames of a walk that is under way, as EuRoC; not to be written to.

    groundtruth.tum has the true poses of just these frames.
    """
    from data_synth.frame_rendering import render_frames
    from data_synth.plan import make_plan
    from data_synth.recipe import load_recipe
    from data_synth.writers import euroc
    from vo.base.types import Trajectory

    settings = ["motion=handheld", "seconds=4", "speed=1.5", "scale=0.625", "effects.exposure=0"]
    plan = make_plan(load_recipe("demo", settings))
    taken = slice(20, 50)
    recording = replace(
        plan.recording,
        stamps_ns=tuple(stamps[taken] for stamps in plan.recording.stamps_ns),
        dropped=tuple(dropped[taken] for dropped in plan.recording.dropped),
        cam0_truth=Trajectory(
            plan.recording.cam0_truth.stamps_ns[taken],
            plan.recording.cam0_truth.world_from_cam[taken],
        ),
    )
    folder = tmp_path_factory.mktemp("synthetic") / "walk"
    with ThreadPoolExecutor() as pool:
        shots = render_frames(plan, pool, range(taken.start, taken.stop))
        renumbered = (replace(shot, index=shot.index - taken.start) for shot in shots)
        euroc.write(folder, recording, renumbered, "png")
    return folder


@pytest.fixture
def shared_data() -> Path:
    """Folder of the real sequences beside the checkout; the test is skipped where it is absent."""
    folder = Path(__file__).resolve().parents[1].parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the real sequences are not at {folder}")
    return folder
