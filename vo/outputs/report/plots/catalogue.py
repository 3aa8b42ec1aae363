"""All figures of a report, by name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from vo.outputs.report.entry import Entry
from vo.outputs.report.plots import errors, paths, style, tracking

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Plot(NamedTuple):
    """A figure with its file name, caption, and number of its run, None for several runs."""

    name: str
    caption: str
    figure: Figure
    run: int | None = None


_PATH = "Camera path from above and from the side"
_ALL_RUNS = (
    (
        "error_time",
        "Error of each pose over time, after alignment to the ground truth.",
        errors.draw_errors_over_time,
    ),
    (
        "error_distance",
        "Error of each pose by distance travelled, after alignment to the ground truth.",
        errors.draw_errors_over_distance,
    ),
    (
        "rpe",
        "Cumulative distribution of relative errors. The dot is the median.",
        errors.draw_relative_errors,
    ),
    ("drift", "Mean drift over sub-paths of each length.", errors.draw_drift),
    (
        "uncertainty",
        "Standard deviation of each keyframe's pose relative to the first of its segment, from "
        "the covariance.",
        tracking.draw_uncertainty,
    ),
)
_COMPARISONS = (
    ("inliers", "Inliers over time.", tracking.draw_inliers),
    ("times", "Cumulative distribution of the wall time per frame.", tracking.draw_total_times),
)
_LOOPS = (
    "loops",
    "The path from above, before and after loops were closed, and the keyframes that each loop "
    "connects.",
    paths.draw_loops,
)
_SINGLE_RUN = (
    _LOOPS,
    ("markers", "The markers and the path from above.", paths.draw_markers),
    (
        "counts",
        "Matched landmarks, and inliers among them, over time.",
        tracking.draw_counts,
    ),
    ("stages", "Wall time of the frames by stage.", tracking.draw_stages),
)


def draw_all(entries: Sequence[Entry]) -> Iterator[Plot]:
    """All figures for which there are data."""
    with style.drawing():
        yield from _paths(entries)
        for name, caption, draw in _ALL_RUNS:
            figure = draw(entries)
            if figure is not None:
                yield Plot(name, caption, figure)
        for name, caption, draw in _COMPARISONS if len(entries) > 1 else ():
            figure = draw(entries)
            if figure is not None:
                yield Plot(name, caption, figure)
        for number, entry in enumerate(entries):
            for name, caption, draw_one in _SINGLE_RUN:
                figure = draw_one(entry)
                if figure is not None:
                    suffix = f"_{number + 1}" if len(entries) > 1 else ""
                    yield Plot(name + suffix, caption, figure, number)


def _paths(entries: Sequence[Entry]) -> Iterator[Plot]:
    """One figure for the runs of each recording, which have a common world frame."""
    sources = list(dict.fromkeys(str(entry.run.summary["source"]) for entry in entries))
    for number, source in enumerate(sources, start=1):
        together = [entry for entry in entries if str(entry.run.summary["source"]) == source]
        figure = paths.draw_paths(together)
        if figure is None:
            continue
        if len(sources) == 1:
            yield Plot("path", f"{_PATH}.", figure)
        else:
            yield Plot(f"path_{number}", f"{_PATH}, {source}.", figure)
