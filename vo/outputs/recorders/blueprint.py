"""Layout of a recording in the viewer."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from vo.base.types import Rig
from vo.outputs.recorders import entities

_WIDE = 1.8  # width by height above which the images are placed one above the other
_SHOWN_MS = (0.0, 300.0)  # the first frame takes much longer than the others


def make_blueprint(rig: Rig, *, has_truth: bool, has_images: bool = True) -> rrb.Blueprint:
    """Map, events and summary on the left; images and time series on the right."""
    left = rrb.Vertical(_map_view(), _texts(), row_shares=[7, 3])
    right: list[rrb.Container | rrb.View] = [_plots(has_truth=has_truth)]
    if has_images:
        right.insert(0, _images(rig))
    return rrb.Blueprint(
        rrb.Horizontal(left, rrb.Vertical(*right, row_shares=[6, 4][: len(right)])),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=entities.FRAME_TIMELINE),
        auto_views=False,
        auto_layout=False,
    )


def _map_view() -> rrb.Spatial3DView:
    history = rrb.VisibleTimeRanges([_until_now(timeline) for timeline in _timelines()])
    growing = (
        entities.CAUSAL_PATH,
        entities.SMOOTHED_PATH,
        entities.SETTLED_LANDMARKS,
        entities.COVARIANCE,
        entities.LOOPS,
    )
    flat = (
        *(entities.FEATURES, entities.MATCHES, entities.EPIPOLAR, entities.MARKERS),
        entities.RIGHT,
    )
    return rrb.Spatial3DView(
        name="Map",
        origin=entities.WORLD,
        contents=["+ $origin/**", *(f"- {entity}/**" for entity in flat)],
        overrides={path: history for path in growing},
        background=entities.MAP_BACKGROUND,
        line_grid=False,
    )


def _images(rig: Rig) -> rrb.Container:
    views = [_image_view("Left", entities.LEFT)]
    if rig.is_stereo:
        views.append(_image_view("Right", entities.RIGHT))
    is_wide = rig.cam0.width > _WIDE * rig.cam0.height
    return rrb.Vertical(*views) if is_wide else rrb.Horizontal(*views)


def _image_view(name: str, origin: str) -> rrb.Spatial2DView:
    """One image with its overlays; epipolar lines are hidden by default."""
    return rrb.Spatial2DView(
        name=name,
        origin=origin,
        contents="$origin/**",
        overrides={entities.EPIPOLAR: rrb.EntityBehavior(visible=False)},
    )


def _plots(*, has_truth: bool) -> rrb.Container:
    matches = _plot("Matches", entities.TRACKING_PLOT, rrb.Corner2D.LeftBottom)
    others = [
        _plot("Reprojection error, px", entities.REPROJECTION_PLOT, rrb.Corner2D.LeftTop),
        rrb.TimeSeriesView(
            name="Milliseconds",
            origin=entities.TIME_PLOT,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
            axis_y=rrb.ScalarAxis(range=_SHOWN_MS),
        ),
    ]
    if has_truth:
        others.insert(0, _plot("Error, m", entities.ERROR_PLOT, rrb.Corner2D.LeftTop))
    return rrb.Horizontal(matches, rrb.Tabs(*others, active_tab=0))


def _texts() -> rrb.Container:
    events = rrb.TextLogView(name="Events", origin=entities.EVENTS, columns=_event_columns())
    summary = rrb.TextDocumentView(name="Summary", origin=entities.SUMMARY)
    return rrb.Horizontal(events, summary, column_shares=[3, 2])


def _plot(name: str, origin: str, legend: rrb.Corner2D) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=name, origin=origin, plot_legend=rrb.PlotLegend(legend))


def _event_columns() -> rrb.TextLogColumns:
    """One time and no entity path, which is the same in each row, to leave space for the text."""
    return rrb.TextLogColumns(
        timeline_columns=[entities.FRAME_TIMELINE],
        text_log_columns=["LogLevel", "Body"],
    )


def _timelines() -> tuple[str, str]:
    return entities.FRAME_TIMELINE, entities.SENSOR_TIMELINE


def _until_now(timeline: str) -> rr.VisibleTimeRange:
    """Show all rows up to the time cursor, of an entity that is logged piece by piece."""
    return rrb.VisibleTimeRange(
        timeline,
        start=rrb.TimeRangeBoundary.infinite(),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
