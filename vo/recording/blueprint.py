"""How the viewer lays a recording out when it is opened."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from vo.recording import entities


def make_blueprint() -> rrb.Blueprint:
    """The map on the left; image, time series and events on the right."""
    right = rrb.Vertical(
        _image_view(),
        rrb.Horizontal(
            _plot("Matches", entities.TRACKING_PLOT, rrb.Corner2D.LeftBottom),
            _plot("Milliseconds per frame", entities.TIME_PLOT, rrb.Corner2D.LeftTop),
        ),
        rrb.TextLogView(name="Events", origin=entities.EVENTS, columns=_event_columns()),
        row_shares=[9, 8, 5],
    )
    return rrb.Blueprint(
        rrb.Horizontal(_map_view(), right, column_shares=[1, 1]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=entities.FRAME_TIMELINE),
        auto_views=False,
        auto_layout=False,
    )


def _map_view() -> rrb.Spatial3DView:
    history = rrb.VisibleTimeRanges([_until_now(timeline) for timeline in _timelines()])
    growing = (entities.CAUSAL_PATH, entities.SMOOTHED_PATH, entities.SETTLED_LANDMARKS)
    return rrb.Spatial3DView(
        name="Map",
        origin=entities.WORLD,
        contents=["+ $origin/**", f"- {entities.KEYPOINTS}/**", f"- {entities.MATCHES}"],
        overrides={path: history for path in growing},
    )


def _image_view() -> rrb.Spatial2DView:
    return rrb.Spatial2DView(name="Image", origin=entities.CAMERA, contents="$origin/**")


def _plot(name: str, origin: str, legend: rrb.Corner2D) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=name, origin=origin, plot_legend=rrb.PlotLegend(legend))


def _event_columns() -> rrb.TextLogColumns:
    """All but the entity path, which is the same in each row."""
    return rrb.TextLogColumns(
        timeline_columns=[entities.FRAME_TIMELINE, entities.SENSOR_TIMELINE],
        text_log_columns=["LogLevel", "Body"],
    )


def _timelines() -> tuple[str, str]:
    return entities.FRAME_TIMELINE, entities.SENSOR_TIMELINE


def _until_now(timeline: str) -> rr.VisibleTimeRange:
    """What grows is logged piece by piece; the view shows all pieces up to the time cursor."""
    return rrb.VisibleTimeRange(
        timeline,
        start=rrb.TimeRangeBoundary.infinite(),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
