"""Loops, relocalisations and the path before them, as lines in the map view and as events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from vo.base.records.closed_loops import ClosedLoop
from vo.base.records.seen_markers import SeenMarkers
from vo.base.types import Floats, Trajectory
from vo.outputs.recorders import entities
from vo.outputs.recorders.recorder import LoopClosures
from vo.outputs.recorders.settled_layer import add_strips
from vo.outputs.recorders.timelines import Batch, Moment, Strips


class LoopLayer:
    """Draws what is known of loops at the end of a run.

    A loop appears at the first frame whose pose it corrected, where the final path has its two
    keyframes. One to a keyframe of a loaded map is an event alone.

    `moments`: of the recorded frames, by number.
    """

    def __init__(self, batch: Batch, moments: Mapping[int, Moment]) -> None:
        self._batch = batch
        self._moments = moments

    def log(
        self, closures: LoopClosures, smoothed: Trajectory, odometry: Sequence[Trajectory]
    ) -> None:
        """Log lines and events.

        `smoothed`: the path after all loops. `odometry`: the path before them, divided by segments.
        """
        style = rr.LineStrips3D.from_fields(
            colors=[entities.YELLOW], radii=rr.Radius.ui_points(1.5)
        )
        self._batch.log_static(entities.LOOPS, style)
        before = rr.LineStrips3D(
            [piece.positions for piece in odometry],
            colors=[entities.GREY],
            radii=rr.Radius.ui_points(1.0),
        )
        self._batch.log_static(entities.ODOMETRY_PATH, before)
        last = max(self._moments)
        by_moment: dict[Moment, list[Floats]] = {}
        for loop in sorted(closures.loops, key=lambda each: each.frame):
            at = last if loop.corrected_from is None else loop.corrected_from
            moment = self._moments.get(at, self._moments[last])
            session = "" if loop.earlier_session is None else f" of session {loop.earlier_session}"
            self._add_event(
                moment,
                f"{loop.kind}: frame {loop.frame} sees the place of frame "
                f"{loop.earlier_frame}{session} ({loop.inliers} inliers)",
            )
            line = self._line(loop, smoothed)
            if line is not None:
                by_moment.setdefault(moment, []).append(line)
        for moment, lines in sorted(by_moment.items()):
            add_strips(self._batch, moment, entities.LOOPS, lines)
        for found in closures.relocalisations:
            if found.frame in self._moments:
                self._add_event(
                    self._moments[found.frame],
                    f"relocalised: segment {found.segment} is at the place of frame "
                    f"{found.earlier_frame} ({found.loops} keyframes, {found.inliers} inliers)",
                )

    def _line(self, loop: ClosedLoop, smoothed: Trajectory) -> Floats | None:
        """(2, 3) from the later keyframe to the earlier one; None if one is not in the path."""
        if loop.earlier_session is not None:
            return None
        ends = [self._moments.get(frame) for frame in (loop.frame, loop.earlier_frame)]
        stamps = [moment.stamp_ns for moment in ends if moment is not None]
        rows = np.searchsorted(smoothed.stamps_ns, stamps)
        known = rows < len(smoothed)
        if len(stamps) < 2 or not known.all() or (smoothed.stamps_ns[rows] != stamps).any():
            return None
        return smoothed.positions[rows]

    def _add_event(self, moment: Moment, text: str) -> None:
        self._batch.add(moment, entities.EVENTS, rr.TextLog, text=[text], level=["INFO"])


_RADIUS = 1.5  # ui points


class MarkerLayer:
    """Draws the markers of a run at its end.

    `moments`: of the recorded frames, by number. `image_scale`: size of recorded images relative to
    those of the run.
    """

    def __init__(self, batch: Batch, moments: Mapping[int, Moment], image_scale: float) -> None:
        self._batch = batch
        self._moments = moments
        self._image_scale = image_scale

    def log(self, seen: SeenMarkers) -> None:
        """Log outlines at the frames where they are, and squares from the first of them on."""
        radii = rr.Radius.ui_points(_RADIUS)
        style = rr.LineStrips2D.from_fields(colors=[entities.YELLOW], radii=radii, draw_order=30.0)
        self._batch.log_static(entities.MARKERS, style)
        self._add_outlines(seen)
        for square in seen.squares:
            moment = self._moments.get(square.first_frame)
            if moment is None:
                continue
            entity = f"{entities.MARKER_SQUARES}/{square.segment}/{square.id}"
            style3d = rr.LineStrips3D.from_fields(
                colors=[entities.YELLOW], radii=radii, labels=[str(square.id)]
            )
            self._batch.log_static(entity, style3d)
            closed = np.concatenate([square.corners, square.corners[:1]])
            strips = Strips.of_equal_size(closed[None])
            self._batch.add(moment, entity, rr.LineStrips3D, strips=strips)

    def _add_outlines(self, seen: SeenMarkers) -> None:
        """A row for each frame with markers, and an empty one for the frame after it."""
        by_frame: dict[int, list[int]] = {}
        for row, outline in enumerate(seen.outlines):
            if outline.frame_index in self._moments:
                by_frame.setdefault(outline.frame_index, []).append(row)
        was_shown = False
        for frame in sorted(self._moments):
            rows = by_frame.get(frame, [])
            if not rows and not was_shown:
                continue
            was_shown = bool(rows)
            corners = np.array([seen.outlines[row].corners for row in rows]).reshape(-1, 4, 2)
            closed = np.concatenate([corners, corners[:, :1]], axis=1)
            strips = Strips.of_equal_size((closed + 0.5) * self._image_scale)
            labels = [str(seen.outlines[row].id) for row in rows]
            moment = self._moments[frame]
            self._batch.add(moment, entities.MARKERS, rr.LineStrips2D, strips=strips, labels=labels)
