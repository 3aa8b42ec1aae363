"""Markers: outlines in the images that show them, and squares in the map view."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr

from vo.base.records.seen_markers import SeenMarkers
from vo.outputs.recorders import entities
from vo.outputs.recorders.batch import Batch, Strips
from vo.outputs.recorders.timelines import Moment

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
