"""All figures of a report, by name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from vo.outputs.report.entry import Entry
from vo.outputs.report.plots import errors, paths, style, tracking
from vo.outputs.report.shown_paths import shown_paths

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Plot(NamedTuple):
    """A figure with its file name, caption, and number of its run, None for several runs."""

    name: str
    caption: str
    figure: Figure
    run: int | None = None


_PATHS = (
    ("path", "Camera path from above", paths.draw_above),
    ("path_side", "Camera path from the side", paths.draw_side),
    (
        "positions",
        "Coordinates over time; the band is two standard deviations wide on each side",
        paths.draw_positions,
    ),
    (
        "angles",
        "Heading (clockwise from above), pitch (upwards) and roll (to the right) over time",
        paths.draw_angles,
    ),
)
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
_SINGLE_RUN = (
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
    """Figures for the runs of each recording, which have a common world frame."""
    groups = shown_paths(entries)
    for number, shown in enumerate(groups, start=1):
        suffix, source = (f"_{number}", f", {shown.source}") if len(groups) > 1 else ("", "")
        for name, caption, draw in _PATHS:
            yield Plot(name + suffix, f"{caption}{source}.", draw(shown))
