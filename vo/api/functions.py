"""Functions of the public interface: recordings, runs and evaluations by one call each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict, Unpack, get_type_hints

from vo.api.eval_inputs import read_inputs
from vo.api.run_words import RunWords, split_words
from vo.api.same_bits import prepare
from vo.base.config import Config, load_config
from vo.base.errors import ConfigError
from vo.base.types import Trajectory
from vo.outputs.evaluation.alignment import AlignMethod
from vo.outputs.evaluation.evaluation import Evaluation
from vo.outputs.evaluation.evaluation import evaluate as evaluate_trajectories
from vo.outputs.evaluation.inputs import GivenTrajectory
from vo.outputs.evaluation.plots import save_plot
from vo.outputs.results.output_paths import is_run_folder, refuse_to_overwrite
from vo.outputs.results.summary import Summary
from vo.recordings.sources.source import FrameStream
from vo.runs.run_options import checked_options
from vo.runs.run_recording import run as run_recording
from vo.tools.drawing import check_plot


class EvaluateWords(TypedDict, total=False):
    """Options of `evaluate`.

    `align`: `se3`, `sim3`, `scale`, `none`, or `auto` for that of the run's mode, else `se3`.
    `tolerance_s`: largest time between paired poses. `interpolated`: whether the reference is
    interpolated. `delta_frames`, `delta_m`: step of relative errors, in paired poses and metres.
    `all_segments`: all of a run as one. `topics`: poses in logs, such as `["estimate=/odom"]`.
    `calibration`: file with the pose of cam0 on the body, for ground truth of the body. `picture`:
    plot to write.
    """

    align: AlignMethod
    tolerance_s: float
    interpolated: bool
    delta_frames: int
    delta_m: float | None
    all_segments: bool
    topics: Sequence[str]
    calibration: str | Path | None
    picture: str | Path | None


def run(
    source: str | Path | FrameStream,
    output: str | Path,
    config: Config | str | Path = "default",
    *,
    overrides: Sequence[str] = (),
    **options: Unpack[RunWords],
) -> Summary:
    """Compute a camera's path from a recording and write it, as `vo run` does.

    Args:
        source: folder or file of the recording, or a stream of frames.
        output: folder for the results (docs/outputs.md); those of an earlier run are removed.
        config: `default`, `fast`, `accurate`, `best`, a YAML file, or a `vo.Config`.
        overrides: settings to change, such as `["features.count=2500"]`.
        **options: the words of `vo run --help-all`, such as `mode="mono"`, `height=1.65`,
            `markers=0.16`, `mask="body.png"`, `rrd="run.rrd"`, `imu=False` (docs/library.md).

    Raises:
        ConfigError: an option or setting is unknown, or its value is of another type.
        VoError: see `vo.runs.run_recording.run`.
    """
    settings, given = split_words(options)
    if not isinstance(config, Config):
        config = load_config(config, [*overrides, *settings])
    elif overrides or settings:
        name = (*settings, "overrides")[0].partition("=")[0]
        raise ConfigError(
            f"{name} is a setting: give it in the Config, or config as a name or file"
        )
    prepare()
    return run_recording(source, Path(output), config=config, **given)


def evaluate(
    estimate: str | Path | Trajectory,
    reference: str | Path | Trajectory,
    **words: Unpack[EvaluateWords],
) -> Evaluation:
    """Errors of a trajectory against ground truth, as `vo eval` prints them.

    Args:
        estimate: a trajectory, its file in any supported format, the folder of a run, or a log.
        reference: a trajectory, its file, a recording with ground truth, or another run.
        **words: those of `EvaluateWords`, such as `align="sim3"`, `delta_m=10.0`, `picture=`.

    Raises:
        VoError: a file is missing or damaged, or the trajectories cannot be compared.
    """
    given = checked_options(words, get_type_hints(EvaluateWords))
    plot, calibration = (given.pop(name, None) for name in ("picture", "calibration"))
    if plot is not None:
        files = [Path(each) for each in (estimate, reference) if not isinstance(each, Trajectory)]
        refuse_to_overwrite([each for each in files if not is_run_folder(each)], [Path(plot)])
        check_plot(Path(plot))
    inputs = read_inputs(
        _given(estimate, "estimate"),
        _given(reference, "reference"),
        topics=given.pop("topics", ()),
        calibration=None if calibration is None else Path(calibration),
        all_segments=given.pop("all_segments", False),
    )
    align = given.pop("align", "auto")
    evaluation = evaluate_trajectories(
        inputs.estimate, inputs.reference, align, inputs.mode, **given
    )
    if plot is not None:
        save_plot(Path(plot), evaluation, inputs.reference, inputs.title)
    return evaluation


def _given(trajectory: str | Path | Trajectory, name: str) -> Path | GivenTrajectory:
    if isinstance(trajectory, Trajectory):
        return GivenTrajectory(trajectory, Path(name))
    return Path(trajectory)
