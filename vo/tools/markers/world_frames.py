"""Worlds of a run in the frame of a marker or of a map of markers, and markers.csv."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.files.complete_file import writing
from vo.base.geometry.transforms import inverse, quat_xyzw_from_rotation
from vo.base.records.metric_scale import MetricScale, WorldFrame
from vo.base.types import Floats
from vo.tools.markers.map_fit import register_in_map
from vo.tools.markers.marker_map import MarkerMap
from vo.tools.markers.scale_fit import RegisteredMarker

MARKERS_FILE = "markers.csv"
_COLUMNS = (
    *("segment", "id", "tx", "ty", "tz", "qx", "qy", "qz", "qw", "sigma_m"),
    *("views", "first_frame", "last_frame", "error", "dictionary", "length_m"),
)


class FoundMarker(NamedTuple):
    """A marker in a world."""

    world: int  # number of the world
    marker: RegisteredMarker  # its pose, in metres by the sides of markers
    metres_per_unit: float  # these metres in a unit of the map
    # Whether it may place the world: it agrees with the map of markers, if there is one
    is_used: bool = True

    def in_metres(self, scales: Mapping[int, MetricScale]) -> RegisteredMarker:
        """The marker in the metres of the path, which may have got them from another source."""
        scale = scales.get(self.world)
        factor = (1.0 if scale is None else scale.value) / self.metres_per_unit
        pose = self.marker.world_from_marker.copy()
        pose[:3, 3] *= factor
        sigma_m = factor * self.marker.sigma_m
        return self.marker._replace(world_from_marker=pose, sigma_m=sigma_m)


class NewWorlds(NamedTuple):
    """Other frames of worlds."""

    poses: Mapping[int, Floats] = {}  # (4, 4) new_from_world by number of the world, in metres
    frames: tuple[WorldFrame, ...] = ()
    notes: tuple[str, ...] = ()  # sentences for the user, why others have none


def frames_of_marker(
    number: int, found: Iterable[FoundMarker], scales: Mapping[int, MetricScale]
) -> NewWorlds:
    """The frame of one marker, in each world that shows it."""
    poses, frames = {}, []
    for each in found:
        if each.marker.id == number:
            marker = each.in_metres(scales)
            poses[each.world] = inverse(marker.world_from_marker)
            turn = float(np.rad2deg(marker.sigma_rad))
            name = f"marker {number}"
            frames.append(WorldFrame(each.world, name, (number,), marker.sigma_m, turn))
    if poses:
        return NewWorlds(poses, tuple(frames))
    note = f"marker {number} has no pose in the path, which keeps its world frame"
    return NewWorlds(notes=(note,))


def frames_of_map(
    known: MarkerMap,
    found: Sequence[FoundMarker],
    scales: Mapping[int, MetricScale],
    worlds: Sequence[int],
) -> NewWorlds:
    """The frame of a map, in each world with markers that agree with it."""
    poses, frames = {}, []
    for world in worlds:
        markers = [each.in_metres(scales) for each in found if each.world == world and each.is_used]
        if not markers:
            continue
        place = register_in_map(markers, known.markers)
        poses[world] = place.map_from_world
        ids = tuple(marker.id for marker in markers)
        turn = float(np.rad2deg(place.sigma_rad))
        frames.append(WorldFrame(world, known.name, ids, place.sigma_m, turn))
    others = [str(world) for world in worlds if world not in poses]
    if not others:
        return NewWorlds(poses, tuple(frames))
    which = "segment" if len(others) == 1 else "segments"
    note = (
        f"{which} {', '.join(others)} cannot be placed in {known.name}: the path there keeps the "
        "frame of its first camera"
    )
    return NewWorlds(poses, tuple(frames), (note,))


def write_markers(
    folder: Path,
    found: Iterable[FoundMarker],
    worlds: Mapping[int, Floats],
    scales: Mapping[int, MetricScale],
    dictionary: str,
) -> None:
    """Write markers.csv: the markers whose pose in a world is known, in metres.

    `worlds`: (4, 4) new_from_world of worlds with another frame, by number. `scales`: by which the
    worlds have been converted.

    Raises:
        OutputError: it cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for each in found:
        marker = each.in_metres(scales)
        pose = worlds.get(each.world, np.eye(4)) @ marker.world_from_marker
        quat = quat_xyzw_from_rotation(pose[:3, :3])
        texts = [f"{value:.9g}" for value in (*pose[:3, 3], *quat)]
        ends = (marker.views, marker.first_frame, marker.last_frame, f"{marker.error:.3f}")
        kind = (dictionary, f"{marker.length_m:.9g}")
        writer.writerow((each.world, marker.id, *texts, f"{marker.sigma_m:.4g}", *ends, *kind))
    path = folder / MARKERS_FILE
    with writing(path):
        path.write_text(text.getvalue(), encoding="utf-8")
