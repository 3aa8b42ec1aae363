"""Render and write a whole recording with ground truth."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

from data_synth.frame_rendering import render_frames
from data_synth.plan import make_plan
from data_synth.recipe import Recipe, dump_recipe
from data_synth.records import Recording, Shot
from data_synth.writers.registry import FORMATS, load_writer
from vo.base.errors import OutputError

OnFrame = Callable[[int, int], None]


def make_sequence(
    output: Path | str,
    recipe: Recipe,
    *,
    force: bool = False,
    on_frame: OnFrame | None = None,
) -> Recording:
    """Write a recording.

    The same recipe gives the same bytes. The recording is renamed into place when it is complete,
    so that nothing is left after an interruption.

    `output`: folder or, for MCAP, file to make; it must not exist, or be an empty folder.
    `on_frame`: called with the number of frames done and their total.

    Raises:
        ConfigError: the recipe is not feasible.
        CalibrationError: the calibration of the camera is invalid.
        OutputError: the output exists already, or cannot be written.
    """
    path = Path(output)
    _check_output(path, force)  # before rendering, which takes long
    plan = make_plan(recipe)
    write = load_writer(recipe.format)
    with _atomic_output(path, force) as partial, ThreadPoolExecutor() as pool:
        shots = _counted(render_frames(plan, pool), len(plan.recording), on_frame)
        write(partial, plan.recording, shots, recipe.codec)
        if not FORMATS[recipe.format].suffix:
            (partial / "recipe.yaml").write_text(dump_recipe(recipe), encoding="utf-8")
    return plan.recording


def _counted(shots: Iterator[Shot], total: int, on_frame: OnFrame | None) -> Iterator[Shot]:
    for done, shot in enumerate(shots, start=1):
        yield shot
        if on_frame is not None:
            on_frame(done, total)


def _check_output(path: Path, force: bool) -> None:
    try:
        taken = path.exists() and (not path.is_dir() or any(path.iterdir()))
    except OSError as error:
        raise OutputError(f"{path} cannot be read: {error.strerror or error}") from error
    if taken and not force:
        raise OutputError(f"{path} exists already; choose another path, or `force` to replace it")
    if force and path.is_dir() and not _is_replaceable(path):
        raise OutputError(f"{path} is not a synthetic recording and is not replaced")
    results = next(path.rglob("summary.json"), None) if force and path.is_dir() else None
    if results is not None:
        raise OutputError(
            f"{path} is not replaced: {results.parent} in it has the results of a run; move them "
            "out of it first"
        )
    recording = next((p for p in path.absolute().parents if (p / "recipe.yaml").is_file()), None)
    if recording is not None:
        raise OutputError(f"{path} is inside the recording {recording}; choose another path")


def _is_replaceable(folder: Path) -> bool:
    """Whether a folder may be replaced: it is empty or a synthetic recording."""
    return (folder / "recipe.yaml").is_file() or not any(folder.iterdir())


@contextmanager
def _atomic_output(path: Path, force: bool) -> Iterator[Path]:
    """A temporary path that is renamed to `path` at the end, or removed on an error."""
    partial = path.parent / f".{path.name}.partial-{os.getpid()}"
    try:
        _remove(partial)
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        if force and path.exists():
            _remove(path)
        os.replace(partial, path)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        _remove(partial)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(FileNotFoundError, NotADirectoryError):
            path.unlink()
