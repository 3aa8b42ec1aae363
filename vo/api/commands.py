"""Commands as functions, with the words of the command line and its results as records."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypedDict, Unpack, get_type_hints

from data_synth.recipe import effect_settings, load_recipe
from data_synth.sequence import make_sequence
from vo.api import conversion
from vo.api.conversion_choices import output_format, size_of
from vo.api.report_entries import read_entries
from vo.base.config import load_config
from vo.base.errors import ConfigError
from vo.base.extras import require
from vo.base.types import Mode
from vo.outputs.report.page import make_page, write_page, write_plots
from vo.outputs.results.output_paths import refuse_to_overwrite
from vo.runs.batch.batch import BatchProgress, BatchResult, Engine, LocalEngine, run_batch
from vo.runs.batch.execution import Limits
from vo.runs.batch.job import Job
from vo.runs.batch.planning import plan
from vo.runs.run_options import checked_options
from vo.tools.inspection.images import write_contact_sheet
from vo.tools.inspection.inspection import DEFAULT_IMAGES, inspect
from vo.tools.inspection.opening import open_leniently
from vo.tools.inspection.reports import Report

Name = str | Path
_LIMITS = ("threads", "timeout_s", "memory_mb", "retries")


class Reading(TypedDict, total=False):
    """How a recording is opened."""

    mode: Mode
    calibration: Name | None
    format: str | None
    topics: Sequence[str]
    right_offset_ns: int | None


class ConvertWords(Reading, total=False):
    """Options of `convert`."""

    to: str | None
    codec: str
    start: int
    end: int | None
    stride: int
    resize: str | None
    gray: bool
    force: bool


class BatchWords(TypedDict, total=False):
    """Options of `batch`; `threads`: cores for each recording, with `ray`."""

    overrides: Sequence[str]
    manifest: Name | None
    dataset: str | None
    calibration: Name | None
    mode: Mode
    format: str | None
    jobs: int | None
    ray: str | None
    threads: int
    timeout_s: float | None
    memory_mb: int | None
    retries: int
    report: bool
    progress: BatchProgress | None


class SynthWords(TypedDict, total=False):
    """Options of `synth`."""

    world: str
    motion: str
    camera: Name
    mono: bool
    seconds: float
    fps: float
    seed: int
    to: str
    codec: str
    depth: bool
    effects: str


def info(
    source: Name,
    *,
    all_images: bool = False,
    picture: Name | None = None,
    **reading: Unpack[Reading],
) -> Report:
    """What a recording contains and its problems, as `vo info` finds them; raises `VoError`.

    `picture`: file for a sheet of some of its images, which is not written if none can be read.
    """
    given = checked_options(reading, _hints(Reading))
    refuse_to_overwrite((Path(source), given.get("calibration")), (_path(picture),))
    opened = open_leniently(Path(source), **_reading(given))
    report = inspect(opened, None if all_images else DEFAULT_IMAGES)
    if picture is not None and opened.cameras:
        write_contact_sheet(Path(picture), opened)
    return report


def convert(source: Name, output: Name, **words: Unpack[ConvertWords]) -> Path:
    """Write a recording in another format, size or length, as `vo convert`; raises `VoError`."""
    given, path = checked_options(words, _hints(ConvertWords)), Path(output)
    refuse_to_overwrite((Path(source), given.get("calibration")), (path,))
    settings = conversion.Conversion(
        output_format(given.pop("to", None), path),
        given.pop("codec", "png"),
        size=size_of(given.pop("resize", None)),
        **{name: given.pop(name) for name in ("start", "end", "stride", "gray") if name in given},
    )
    force = given.pop("force", False)
    opened = open_leniently(Path(source), **_reading(given))
    conversion.convert(opened, path, settings, force=force)
    return path


def synth(
    output: Name,
    preset: Name | None = None,
    *,
    overrides: Sequence[str] = (),
    force: bool = False,
    **words: Unpack[SynthWords],
) -> Path:
    """Render a recording with exact ground truth, as `vo synth`.

    Args:
        output: folder, or file for MCAP.
        preset: settings to start from: a preset or a YAML file.
        overrides: such as `["effects.blur=2"]`.
        force: whether an existing recording is replaced.
        **words: world, motion, camera, mono, seconds, fps, seed, to, codec, depth, and effects,
            such as `effects="blur=2,noise=3"`.

    Raises:
        VoError: a setting is unknown or not feasible, or the output cannot be written.
    """
    named = checked_options(words, _hints(SynthWords))
    effects = effect_settings(named.pop("effects", ""))
    given = [f"{'format' if key == 'to' else key}={value}" for key, value in named.items()]
    recipe = load_recipe(None if preset is None else str(preset), [*overrides, *given, *effects])
    make_sequence(output, recipe, force=force)
    return Path(output)


def report(
    runs: Name | Sequence[Name],
    output: Name | None = None,
    *,
    truth: Name | None = None,
    picture: Name | None = None,
    images: bool = True,
) -> Path:
    """Write an HTML page of one or several runs, as `vo report`; its path.

    Raises:
        VoError: a run is missing or damaged, the page cannot be written, or the extra is missing.
    """
    require("matplotlib", "report", "reports")
    from vo.outputs.report.plots.catalogue import draw_all

    folders = [Path(runs)] if isinstance(runs, str | Path) else [Path(each) for each in runs]
    page = Path(output or (folders[0] if len(folders) == 1 else Path()) / "report.html")
    entries = read_entries(folders, _path(truth), images)
    recordings = [Path(str(entry.run.summary["source"])) for entry in entries]
    refuse_to_overwrite([*recordings, _path(truth)], [page, _path(picture)])
    figures = list(draw_all(entries))
    write_page(page, make_page(entries, figures))
    if picture is not None:
        write_plots(Path(picture), figures)
    return page


def batch(
    sources: Name | Sequence[Name],
    output: Name,
    config: Name = "default",
    **words: Unpack[BatchWords],
) -> BatchResult:
    """Run on many recordings, each in a process of its own, as `vo batch`; raises `VoError`."""
    given = checked_options(words, _hints(BatchWords))
    overrides = tuple(given.get("overrides", ()))
    load_config(config, overrides)  # a wrong setting is one error, not one for each run
    names = [sources] if isinstance(sources, str | Path) else sources
    path = None if given.get("calibration") is None else str(given["calibration"])
    mode = given.get("mode", "auto")
    shared = Job("", "", str(config), overrides, mode, path, given.get("format"))
    planned = plan(list(map(str, names)), shared, given.get("manifest"), given.get("dataset"))
    engine = _engine(given)
    return run_batch(planned, Path(output), engine, given.get("progress"))


def _engine(given: dict[str, Any]) -> Engine:
    """This machine, or a cluster."""
    named = {name: given[name] for name in _LIMITS if name in given}
    limits = Limits(**named, has_report=given.get("report", False))
    ray, jobs = given.get("ray"), given.get("jobs")
    if ray is None and "threads" in given:
        raise ConfigError("`threads` goes with `ray`; on this machine `jobs` decides")
    if ray is not None and jobs is not None:
        raise ConfigError("`jobs` is for this machine; Ray decides by cores (`threads`)")
    if ray is None:
        return LocalEngine(jobs, limits)
    from vo.runs.batch.cluster import RayEngine

    return RayEngine(ray, limits)


def _reading(given: dict[str, Any]) -> dict[str, Any]:
    """All keywords of `open_leniently`."""
    usual = {"mode": "auto", "calibration": None, "format": None, "right_offset_ns": None}
    return usual | given | {"topics": tuple(given.get("topics", ()))}


def _hints(words: type) -> dict[str, Any]:
    return get_type_hints(words)


def _path(name: Name | None) -> Path | None:
    return None if name is None else Path(name)
