"""Functions of the public interface: recordings, runs and evaluations by one call each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

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
from vo.runs.run_recording import run as run_recording
from vo.tools.drawing import check_plot


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
        config: `default`, `fast`, `accurate`, a YAML file, or a `vo.Config`.
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
    *,
    align: AlignMethod = "auto",
    tolerance_s: float = 0.01,
    interpolated: bool = False,
    delta_frames: int = 1,
    delta_m: float | None = None,
    all_segments: bool = False,
    topics: Sequence[str] = (),
    calibration: str | Path | None = None,
    picture: str | Path | None = None,
) -> Evaluation:
    """Errors of a trajectory against ground truth, as `vo eval` prints them.

    Args:
        estimate: a trajectory, its file in any supported format, the folder of a run, or a log.
        reference: a trajectory, its file, a recording with ground truth, or another run.
        align: transform that aligns the estimate: `se3`, `sim3`, `scale`, `none`; `auto` for that
            of the run's mode, else `se3`.
        tolerance_s: largest time between paired poses in seconds.
        interpolated: whether to interpolate the reference at the times of the estimate.
        delta_frames: step of relative errors, in paired poses.
        delta_m: step of relative errors in metres; None for one that suits the path.
        all_segments: whether all segments of a run are evaluated as one, not only the longest.
        topics: poses in logs, such as `["estimate=/odom", "truth=/gt"]`.
        calibration: file with the pose of cam0 on the body, for ground truth of the body.
        picture: plot of path and errors to write.

    Raises:
        VoError: a file is missing or damaged, or the trajectories cannot be compared.
    """
    plot = None if picture is None else Path(picture)
    if plot is not None:
        files = [Path(each) for each in (estimate, reference) if not isinstance(each, Trajectory)]
        refuse_to_overwrite([each for each in files if not is_run_folder(each)], [plot])
        check_plot(plot)
    inputs = read_inputs(
        _given(estimate, "estimate"),
        _given(reference, "reference"),
        topics=topics,
        calibration=None if calibration is None else Path(calibration),
        all_segments=all_segments,
    )
    evaluation = evaluate_trajectories(
        inputs.estimate,
        inputs.reference,
        align,
        inputs.mode,
        tolerance_s=tolerance_s,
        interpolated=interpolated,
        delta_frames=delta_frames,
        delta_m=delta_m,
    )
    if plot is not None:
        save_plot(plot, evaluation, inputs.reference, inputs.title)
    return evaluation


def _given(trajectory: str | Path | Trajectory, name: str) -> Path | GivenTrajectory:
    if isinstance(trajectory, Trajectory):
        return GivenTrajectory(trajectory, Path(name))
    return Path(trajectory)
