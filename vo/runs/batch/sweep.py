"""A search for settings over a set of recordings, a part of which is held out.

Every trial is a batch (`vo.runs.batch.batch`) in a folder of its own, so that a sweep that was
killed goes on where it was. Its score is the ratio of its position errors to those of the unchanged
settings. The best settings are those of the lowest score; the recordings that are held out, which
no trial has seen, show whether they are better in general.
"""

from __future__ import annotations

import itertools
import json
import math
import random
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from vo.base.config import dump_config, load_config
from vo.base.errors import ConfigError, EvaluationError, OutputError
from vo.base.extras import require
from vo.outputs.results.folder import write_atomically
from vo.runs.batch.batch import BatchProgress, Engine, run_batch
from vo.runs.batch.comparison import Comparison, compare
from vo.runs.batch.job import Job, JobResult
from vo.runs.batch.planning import Plan

BEST, SUMMARY = "best.yaml", "sweep.json"
_BASELINE, _TRIALS, _CHECK = "baseline", "trials", "held-out"
_MAX_GRID = 10_000
_LOG_RATIO = 10.0  # a range with at least this ratio of its ends is searched on a log scale
_RANGE = re.compile(r"([^.,]+(?:\.\d+)?)\.\.([^.,]+(?:\.\d+)?)")


@dataclass(frozen=True)
class Space:
    """The values of one setting, or the ends of its range, both included."""

    key: str
    values: tuple[str, ...] = ()
    low: float = 0.0
    high: float = 0.0

    @property
    def is_whole(self) -> bool:
        """Whether a range is of whole numbers."""
        return isinstance(self.low, int) and isinstance(self.high, int)


@dataclass(frozen=True)
class Trial:
    """Settings that were tried, and how they compare with the unchanged ones.

    Attributes:
        number: from 1.
        settings: `section.key` and the value of each.
        score: geometric mean of the ratios of ATE to those of the unchanged settings, times that of
            the ratios of frames with a pose, unchanged to changed; infinite if a recording is lost.
        cpu_ratio: geometric mean of the ratios of CPU time.
    """

    number: int
    settings: Mapping[str, str]
    score: float
    cpu_ratio: float


@dataclass(frozen=True)
class SweepResult:
    """What a sweep found: trials, best first, and the best one that is better than no change.

    `check` compares it with the unchanged settings on recordings that no trial has run on.
    """

    trials: tuple[Trial, ...]
    best: Trial | None
    training: tuple[str, ...]
    held_out: tuple[str, ...]
    check: Comparison | None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; an infinite score is None."""

        def plain(trial: Trial) -> dict[str, Any]:
            finite = {k: v for k, v in asdict(trial).items() if k in ("score", "cpu_ratio")}
            finite = {k: v if math.isfinite(v) else None for k, v in finite.items()}
            return {"number": trial.number, "settings": dict(trial.settings), **finite}

        return {
            "trials": [plain(trial) for trial in self.trials],
            "best": None if self.best is None else plain(self.best),
            "training": list(self.training),
            "held_out": list(self.held_out),
            "check": None if self.check is None else self.check.to_dict(),
        }


def parse_space(text: str) -> Space:
    """`section.key=1,2,3` for values, `section.key=1..10` for a range.

    Raises:
        ConfigError: it is neither.
    """
    key, equals, values = (part.strip() for part in text.partition("="))
    if not equals or not key or not values:
        raise ConfigError(f"{text!r} is not of the form section.key=1,2,3 or section.key=1..10")
    found = _RANGE.fullmatch(values)
    if found is None:
        return Space(key, tuple(dict.fromkeys(v.strip() for v in values.split(",") if v.strip())))
    try:
        low, high = (float(end) if re.search(r"[.e]", end) else int(end) for end in found.groups())
    except ValueError as error:
        raise ConfigError(f"{text!r}: the ends of a range are numbers, as in 0.5..2") from error
    if not low < high:
        raise ConfigError(f"{text!r}: a range begins with its lower end")
    return Space(key, (), low, high)


def check_spaces(spaces: Sequence[Space], options: Job) -> None:
    """Refuse settings that `vo run` would refuse: each value and both ends of each range.

    Raises:
        ConfigError: a setting is unknown or has a wrong value, or two are the same.
    """
    keys = [space.key for space in spaces]
    if len(set(keys)) < len(keys):
        raise ConfigError("a setting is given twice; give all its values at once")
    for space in spaces:
        for value in space.values or (str(space.low), str(space.high)):
            load_config(options.config, [*options.overrides, f"{space.key}={value}"])


def split(jobs: Sequence[Job], held_out: float, seed: int) -> tuple[list[Job], list[Job]]:
    """Jobs for trials, and the ratio `held_out` of them, drawn by a seed.

    Raises:
        ConfigError: nothing would be left for trials.
    """
    count = round(held_out * len(jobs))
    if held_out > 0.0 and len(jobs) > 1:
        count = max(1, count)
    if count >= len(jobs):
        raise ConfigError(
            f"`held_out={held_out:g}` of {len(jobs)} recordings leaves none for the trials"
        )
    drawn = set(random.Random(seed).sample(range(len(jobs)), count))
    return (
        [job for n, job in enumerate(jobs) if n not in drawn],
        [job for n, job in enumerate(jobs) if n in drawn],
    )


@dataclass(frozen=True)
class SweepOptions:
    """How a sweep chooses: without `trials` all combinations, without `max_cpu` at any CPU time."""

    trials: int | None = None
    held_out: float = 0.3
    max_cpu: float | None = None
    seed: int = 0


def run_sweep(
    plan: Plan,
    spaces: Sequence[Space],
    output: Path,
    engine: Engine,
    options: SweepOptions = SweepOptions(),
    progress: Callable[[str], BatchProgress | None] = lambda _: None,
) -> SweepResult:
    """Search for settings with lower position errors.

    Raises:
        ConfigError: a setting or option is wrong.
        EvaluationError: no recording has ground truth.
        MissingExtraError: Optuna is not installed.
        OutputError: `best.yaml` in the folder is not that of an earlier sweep.
        KeyboardInterrupt: a batch was stopped.
    """
    if (output / BEST).exists() and not (output / SUMMARY).exists():
        raise OutputError(
            f"{output / BEST} is not a result of an earlier sweep and would be replaced; "
            "choose another `output`"
        )
    training, others = split(plan.jobs, options.held_out, options.seed)

    def batch(name: str, jobs: Sequence[Job], settings: Mapping[str, str]) -> list[JobResult]:
        return _batch(output / name, engine, progress(name), jobs, settings)

    baseline = batch(_BASELINE, plan.jobs, {})
    reference = _of(training, baseline)
    if not any(result.ate_m for result in reference):
        raise EvaluationError(
            "no recording for the trials has ground truth and a path; without errors nothing can "
            "be compared"
        )

    def attempt(number: int, settings: Mapping[str, str]) -> Trial:
        compared = compare(reference, batch(f"{_TRIALS}/{number:04d}", training, settings))
        return Trial(number, settings, _score(compared), _ratio(compared, "cpu_s"))

    limit = math.inf if options.max_cpu is None else options.max_cpu
    found = _trials(spaces, options, attempt)
    ranked = sorted(found, key=lambda t: (t.cpu_ratio > limit, t.score, t.number))
    best = ranked[0] if ranked[0].score < 1.0 and not ranked[0].cpu_ratio > limit else None
    check = None
    if best is not None and others:
        check = compare(_of(others, baseline), batch(_CHECK, others, best.settings))
    first, second = (tuple(job.name for job in part) for part in (training, others))
    result = SweepResult(tuple(ranked), best, first, second, check)
    _write(output, result, plan.jobs[0])
    return result


def _batch(
    folder: Path,
    engine: Engine,
    progress: BatchProgress | None,
    jobs: Sequence[Job],
    settings: Mapping[str, str],
) -> list[JobResult]:
    changed = tuple(f"{key}={value}" for key, value in settings.items())
    planned = Plan(tuple(replace(job, overrides=(*job.overrides, *changed)) for job in jobs))
    result = run_batch(planned, folder, engine, progress)
    if result.is_interrupted:
        raise KeyboardInterrupt
    return list(result.results)


def _of(jobs: Sequence[Job], results: Sequence[JobResult]) -> list[JobResult]:
    names = {job.name for job in jobs}
    return [result for result in results if result.name in names]


def _ratio(compared: Comparison, metric: str) -> float:
    return next((c.ratio for c in compared.changes if c.metric == metric), math.nan)


def _score(compared: Comparison) -> float:
    """Frames without a pose count too, as a path is easily better without its difficult part."""
    ate, tracked = _ratio(compared, "ate_m"), _ratio(compared, "tracked_ratio")
    is_known = math.isfinite(ate) and math.isfinite(tracked)
    return ate * tracked if is_known and not compared.lost else math.inf


def _trials(
    spaces: Sequence[Space],
    options: SweepOptions,
    attempt: Callable[[int, Mapping[str, str]], Trial],
) -> Iterator[Trial]:
    if options.trials is None:
        for number, settings in enumerate(_grid(spaces), start=1):
            yield attempt(number, settings)
        return
    optuna = require("optuna", "sweep", "sweeps with `trials`")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=options.seed))
    for number in range(1, options.trials + 1):
        asked = study.ask()
        trial = attempt(number, {space.key: _suggested(asked, space) for space in spaces})
        study.tell(asked, min(trial.score, 1e3))
        yield trial


def _grid(spaces: Sequence[Space]) -> Iterator[dict[str, str]]:
    ranges = [space.key for space in spaces if not space.values]
    if ranges:
        raise ConfigError(f"{ranges[0]} has a range, which needs a number of `trials`")
    size = math.prod(len(space.values) for space in spaces)
    if size > _MAX_GRID:
        raise ConfigError(
            f"these are {size} combinations, over the limit of {_MAX_GRID}; choose some of them "
            "with `trials`"
        )
    for values in itertools.product(*(space.values for space in spaces)):
        yield {space.key: value for space, value in zip(spaces, values, strict=True)}


def _suggested(trial: Any, space: Space) -> str:
    if space.values:
        return str(trial.suggest_categorical(space.key, space.values))
    if space.is_whole:
        return str(trial.suggest_int(space.key, int(space.low), int(space.high)))
    is_log = space.low > 0.0 and space.high / space.low >= _LOG_RATIO
    return f"{trial.suggest_float(space.key, space.low, space.high, log=is_log):.6g}"


def _write(output: Path, result: SweepResult, job: Job) -> None:
    text = json.dumps(result.to_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(output / SUMMARY, text)
    if result.best is None:
        (output / BEST).unlink(missing_ok=True)
        return
    changed = [f"{key}={value}" for key, value in result.best.settings.items()]
    merged = load_config(job.config, [*job.overrides, *changed])
    head = "".join(f"# {line}\n" for line in ["Best settings of a sweep:", *changed])
    write_atomically(output / BEST, head + dump_config(merged))
