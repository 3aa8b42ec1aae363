"""Entities, colours and layout of a recording; the entity tree is the frame tree.

The colours are those of Okabe and Ito (2008), which are distinct for all kinds of colour vision.
`cam0` is the recorded left camera; `left` and `right` below it are the rectified cameras.
"""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from vo.base.geometry.rig_overlap import is_rig
from vo.base.types import Rig

FRAME_TIMELINE = "frame"
SENSOR_TIMELINE = "sensor_time"

WORLD = "world"
CAM0 = "world/cam0"
LEFT = "world/cam0/left"
LEFT_IMAGE = "world/cam0/left/image"
FEATURES = "world/cam0/left/features"
MATCHES = "world/cam0/left/matches"
EPIPOLAR = "world/cam0/left/epipolar"
MARKERS = "world/cam0/left/markers"
RIGHT = "world/cam0/right"
RIGHT_IMAGE = "world/cam0/right/image"
STEREO_MATCHES = "world/cam0/right/matches"
CAUSAL_PATH = "world/path/causal"
SMOOTHED_PATH = "world/path/smoothed"
WINDOW_PATH = "world/path/window"
TRUE_PATH = "world/path/ground_truth"
LOOPS = "world/path/loops"
ODOMETRY_PATH = "world/path/before_loops"
MARKER_SQUARES = "world/markers"
GRAPH = "world/keyframes/graph"
COVARIANCE = "world/keyframes/covariance_10_sigma"
LOCAL_LANDMARKS = "world/landmarks/local"
SETTLED_LANDMARKS = "world/landmarks/settled"
TRACKING_PLOT = "plot/tracking"
REPROJECTION_PLOT = "plot/reprojection"
ERROR_PLOT = "plot/error"
TIME_PLOT = "plot/ms"
EVENTS = "events"
SUMMARY = "summary"
CAUSAL_POSES = "trajectory/causal"
SMOOTHED_POSES = "trajectory/smoothed"

Colour = tuple[int, int, int]

ORANGE: Colour = (230, 159, 0)
SKY: Colour = (86, 180, 233)
GREEN: Colour = (0, 200, 130)  # lighter than the original, for thin lines
BLUE: Colour = (60, 130, 210)  # lighter than the original, for a dark background
VERMILION: Colour = (225, 85, 20)
PINK: Colour = (204, 121, 167)
YELLOW: Colour = (240, 228, 66)
GREY: Colour = (150, 150, 150)

NEW, TRACKED, LANDMARK, REJECTED = "new", "tracked", "landmark", "rejected"
FEATURE_COLOURS: dict[str, Colour] = {
    NEW: SKY,
    TRACKED: GREEN,
    LANDMARK: PINK,
    REJECTED: VERMILION,
}
STAGE_COLOURS: tuple[Colour, ...] = (ORANGE, SKY, GREEN, PINK, VERMILION, YELLOW, BLUE)
MAP_BACKGROUND: Colour = (22, 24, 29)  # dark: landmarks are grey as in the images


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
        rrb.TimePanel(state="collapsed", timeline=FRAME_TIMELINE),
        auto_views=False,
        auto_layout=False,
    )


def _map_view() -> rrb.Spatial3DView:
    history = rrb.VisibleTimeRanges([_until_now(timeline) for timeline in _timelines()])
    growing = (
        CAUSAL_PATH,
        SMOOTHED_PATH,
        SETTLED_LANDMARKS,
        COVARIANCE,
        LOOPS,
    )
    flat = (
        *(FEATURES, MATCHES, EPIPOLAR, MARKERS),
        RIGHT,
    )
    return rrb.Spatial3DView(
        name="Map",
        origin=WORLD,
        contents=["+ $origin/**", *(f"- {entity}/**" for entity in flat)],
        overrides={path: history for path in growing},
        background=MAP_BACKGROUND,
        line_grid=False,
    )


def _images(rig: Rig) -> rrb.Container:
    views = [_image_view("Left", LEFT)]
    if is_rig(rig):
        names = [f"cam{number}" for number in range(1, len(rig.cameras))]
        return rrb.Grid(*views, *(_image_view(name, f"{CAM0}/{name}") for name in names))
    if rig.is_stereo:
        views.append(_image_view("Right", RIGHT))
    is_wide = rig.cam0.width > _WIDE * rig.cam0.height
    return rrb.Vertical(*views) if is_wide else rrb.Horizontal(*views)


def _image_view(name: str, origin: str) -> rrb.Spatial2DView:
    """One image with its overlays; epipolar lines are hidden by default."""
    return rrb.Spatial2DView(
        name=name,
        origin=origin,
        contents="$origin/**",
        overrides={EPIPOLAR: rrb.EntityBehavior(visible=False)},
    )


def _plots(*, has_truth: bool) -> rrb.Container:
    matches = _plot("Matches", TRACKING_PLOT, rrb.Corner2D.LeftBottom)
    others = [
        _plot("Reprojection error, px", REPROJECTION_PLOT, rrb.Corner2D.LeftTop),
        rrb.TimeSeriesView(
            name="Milliseconds",
            origin=TIME_PLOT,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
            axis_y=rrb.ScalarAxis(range=_SHOWN_MS),
        ),
    ]
    if has_truth:
        others.insert(0, _plot("Error, m", ERROR_PLOT, rrb.Corner2D.LeftTop))
    return rrb.Horizontal(matches, rrb.Tabs(*others, active_tab=0))


def _texts() -> rrb.Container:
    events = rrb.TextLogView(name="Events", origin=EVENTS, columns=_event_columns())
    summary = rrb.TextDocumentView(name="Summary", origin=SUMMARY)
    return rrb.Horizontal(events, summary, column_shares=[3, 2])


def _plot(name: str, origin: str, legend: rrb.Corner2D) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=name, origin=origin, plot_legend=rrb.PlotLegend(legend))


def _event_columns() -> rrb.TextLogColumns:
    """One time and no entity path, which is the same in each row, to leave space for the text."""
    return rrb.TextLogColumns(
        timeline_columns=[FRAME_TIMELINE],
        text_log_columns=["LogLevel", "Body"],
    )


def _timelines() -> tuple[str, str]:
    return FRAME_TIMELINE, SENSOR_TIMELINE


def _until_now(timeline: str) -> rr.VisibleTimeRange:
    """Show all rows up to the time cursor, of an entity that is logged piece by piece."""
    return rrb.VisibleTimeRange(
        timeline,
        start=rrb.TimeRangeBoundary.infinite(),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
