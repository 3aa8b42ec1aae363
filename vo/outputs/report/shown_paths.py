"""Paths of runs in the world that a report shows: the map's, the ground truth's, or their own."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vo.base.errors import SourceError
from vo.base.files.bounded_files import read_text
from vo.base.files.bounded_json import load_json
from vo.base.geometry.geodesy import enu_from_geodetic
from vo.base.geometry.similarity import Similarity, umeyama
from vo.base.geometry.transforms import inverse, so3_exp
from vo.base.types import Floats, Ints, Trajectory
from vo.outputs.evaluation.plots import axes_from_above
from vo.outputs.report.entry import Entry, gaps

_STEP_RAD = 1e-5  # of the derivatives of angles
_GEOJSON = "path.geojson"


class Axes(NamedTuple):
    """World axes (0, 1, 2) to draw rightwards, upwards and as the height, and the height's sign."""

    across: int
    up: int
    vertical: int
    sign: float

    @property
    def basis(self) -> Floats:
        """(3, 3): right, ahead and height, from the world's axes."""
        return np.array([1.0, 1.0, self.sign])[:, None] * np.eye(3)[list(self[:3])]


@dataclass(frozen=True, eq=False)
class ShownPath:
    """The path of a run; arrays are by pose, with NaN for what is unknown."""

    entry: Entry
    stamps_ns: Ints  # (N,)
    world_from_cam: Floats  # (N, 4, 4) in the shown world
    segment: Ints  # (N,)
    error_m: Floats  # (N,) distance to the ground truth
    covariance: Floats  # (N, 6, 6) of rotation and position in the camera's frame
    placements: Mapping[int, Similarity]  # the shown world from that of each segment

    @property
    def positions(self) -> Floats:
        """(N, 3)."""
        return self.world_from_cam[:, :3, 3]

    @property
    def cuts(self) -> list[int]:
        """Rows before which the line is interrupted: poses are missing, or the segment changes."""
        changes = (np.flatnonzero(np.diff(self.segment)) + 1).tolist()
        return sorted({*gaps(self.stamps_ns), *changes})

    @property
    def speed(self) -> Floats:
        """(N,) mean over the steps before and after each pose, in lengths per second."""
        steps = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        speeds = steps / np.maximum(np.diff(self.stamps_ns) * 1e-9, 1e-9)
        speeds[np.array(self.cuts, dtype=np.int64) - 1] = np.nan
        both = np.pad(speeds, 1, constant_values=np.nan)
        before, after = both[:-1], both[1:]
        mean = 0.5 * (before + after)
        return np.where(np.isnan(mean), np.where(np.isnan(before), after, before), mean)

    @property
    def sigmas(self) -> Floats:
        """(N, 3) standard deviations of the position along the shown world's axes."""
        rotation = self.world_from_cam[:, :3, :3]
        return _deviations(rotation, self.covariance[:, 3:, 3:])

    def angles(self, axes: Axes) -> tuple[Floats, Floats]:
        """Heading, pitch and roll (N, 3) of the camera in degrees, and their deviations (N, 3)."""
        rotation = axes.basis @ self.world_from_cam[:, :3, :3]
        angles = _angles(rotation)
        turned = [_angles(rotation @ so3_exp(_STEP_RAD * axis)) - angles for axis in np.eye(3)]
        jacobian = (np.stack(turned, axis=2) + np.pi) % (2.0 * np.pi) - np.pi
        sigmas = _deviations(jacobian / _STEP_RAD, self.covariance[:, :3, :3])
        return np.rad2deg(np.unwrap(angles, axis=0)), np.rad2deg(sigmas)

    def place(self, segment: int, points: Floats) -> Floats:
        """Points (n, 3) of a segment's world in the shown one; NaN if it is not shown."""
        known = self.placements.get(segment)
        return np.full_like(points, np.nan) if known is None else known.transform_points(points)

    def given_positions(self) -> Floats:
        """(P, 3) positions of another sensor, such as of GPS; empty if the run had none."""
        given = self.entry.run.positions
        if given is None:
            return np.empty((0, 3))
        numbers = np.unique(given.segment).tolist()
        placed = [self.place(number, given.xyz[given.segment == number]) for number in numbers]
        found = np.concatenate(placed)
        return found[np.isfinite(found).all(axis=1)]

    def at(self, frames: Sequence[int]) -> Floats:
        """Positions (n, 3) of frames by number, NaN for one without a pose."""
        table = self.entry.run.frames
        found = np.full((len(frames), 3), np.nan)
        if table is None:
            return found
        stamp_of = dict(zip(table.frame.tolist(), table.stamp_ns.tolist(), strict=True))
        row_of = {stamp: row for row, stamp in enumerate(self.stamps_ns.tolist())}
        for number, frame in enumerate(frames):
            row = row_of.get(stamp_of.get(frame, -1))
            if row is not None:
                found[number] = self.positions[row]
        return found

    def before_loops(self) -> Floats:
        """The path before loops (n, 3), which begins at the same pose; empty if unknown.

        A run in a loaded map is in the world, and in mono the unit, of the map.
        """
        run = self.entry.run
        before = run.odometry
        known = self.placements.get(int(self.segment[0]))
        if not len(before) or "map" in run.summary or known is None:
            return np.empty((0, 3))
        first = run.trajectory.world_from_cam[0] @ inverse(before.world_from_cam[0])
        moved = (first @ before.world_from_cam)[:, :3, 3]
        return np.insert(known.transform_points(moved), gaps(before.stamps_ns), np.nan, axis=0)


class ShownPaths(NamedTuple):
    """Paths of one recording in a common world."""

    source: str
    paths: tuple[ShownPath, ...]
    truth: Trajectory | None
    axes: Axes
    unit: str
    is_map: bool  # axes are east, north and up

    @property
    def given_positions(self) -> Floats:
        """(P, 3) positions of another sensor: those of the first run that had some."""
        found = [path.given_positions() for path in self.paths]
        return next((each for each in found if len(each)), np.empty((0, 3)))

    def names(self) -> tuple[str, str, str]:
        """Names of the world's axes."""
        return ("east", "north", "up") if self.is_map else ("x", "y", "z")


def shown_paths(entries: Sequence[Entry]) -> list[ShownPaths]:
    """The paths of each recording; without those that cannot be placed among the others."""
    sources = dict.fromkeys(str(entry.run.summary["source"]) for entry in entries)
    together = [
        [e for e in entries if str(e.run.summary["source"]) == source and len(e.run.trajectory)]
        for source in sources
    ]
    groups = [_group(source, each) for source, each in zip(sources, together, strict=True) if each]
    return [group for group in groups if group.paths]


def _group(source: str, entries: list[Entry]) -> ShownPaths:
    maps = [_map_placements(entry, entries[0]) for entry in entries]
    evaluated = [entry for entry in entries if entry.evaluation is not None]
    is_map = all(maps)
    if is_map:
        placed = list(zip(entries, maps, strict=True))
    elif evaluated:
        placed = [(entry, _truth_placements(entry)) for entry in evaluated]
    else:
        placed = [(entry, _own_placements(entry)) for entry in entries]
    paths = tuple(_shown(*each) for each in placed)
    paths = tuple(path for path in paths if len(path.stamps_ns))
    truth = next((e.truth for e in evaluated if e.truth is not None), None)
    if truth is not None and is_map and evaluated:
        truth = _on_map(truth, evaluated[0], maps[entries.index(evaluated[0])])
    unit = "m" if evaluated or is_map else entries[0].run.unit
    poses = paths[0].world_from_cam if paths else np.eye(4)[None]
    across, up = axes_from_above(poses)
    vertical = 3 - across - up
    sign = -1.0 if poses[:, vertical, 1].mean() > 0 else 1.0  # the camera's y points down
    axes = Axes(0, 1, 2, 1.0) if is_map else Axes(across, up, vertical, sign)
    return ShownPaths(source, paths, truth, axes, unit, is_map)


def _own_placements(entry: Entry) -> dict[int, Similarity]:
    numbers = np.unique(entry.run.segment_of(entry.run.trajectory.stamps_ns))
    return {int(number): Similarity(1.0, np.eye(3), np.zeros(3)) for number in numbers}


def _truth_placements(entry: Entry) -> dict[int, Similarity]:
    evaluations = [each for each in (entry.evaluation, *entry.others) if each is not None]
    return {
        int(entry.run.segment_of(each.matched.stamps_ns[:1])[0]): (
            each.alignment.reference_from_estimate
        )
        for each in evaluations
    }


def _map_placements(entry: Entry, first: Entry) -> dict[int, Similarity]:
    """In metres east, north and up of where the first run begins."""
    places, origins = _on_globe(entry), _on_globe(first)
    if not places or not origins:
        return {}
    origin, found = next(iter(origins.values()))[1][0], {}
    for segment, (xyz, geodetic) in places.items():
        try:
            enu = enu_from_geodetic(geodetic, origin)
            found[segment] = umeyama(xyz, enu, with_scale=True)
        except ValueError:  # too short
            continue
    return found


def _on_globe(entry: Entry) -> dict[int, tuple[Floats, Floats]]:
    """By segment: points in its world, and their latitude, longitude and height.

    From `path.geojson`, or else from the positions that the run was given.
    """
    path, given = entry.run.trajectory, entry.run.positions
    found = {}
    for segment, (stamps, geodetic) in _geodetic(entry).items():
        rows = np.isin(path.stamps_ns, stamps)
        found[segment] = path.positions[rows], geodetic[np.isin(stamps, path.stamps_ns)]
    if found or given is None:
        return found
    known = np.isfinite(given.geodetic).all(axis=1)
    for segment in np.unique(given.segment[known]).tolist():
        rows = known & (given.segment == segment)
        found[segment] = given.xyz[rows], given.geodetic[rows]
    return found


def _geodetic(entry: Entry) -> dict[int, tuple[Ints, Floats]]:
    """Stamps, and latitude, longitude and height, of each line of `path.geojson`."""
    path = entry.run.path / _GEOJSON
    if not path.is_file():
        return {}
    try:
        found = {}
        for feature in load_json(read_text(path))["features"]:
            stamps = np.array(feature["properties"]["stamps_ns"], dtype=np.int64)
            points = np.array(feature["geometry"]["coordinates"], dtype=np.float64)
            if points.shape != (len(stamps), 3) or not np.isfinite(points).all():
                raise ValueError("it needs a stamp and a height for each point")
            found[int(feature["properties"]["segment"])] = stamps, points[:, [1, 0, 2]]
    except (OSError, ValueError, KeyError, TypeError, json.JSONDecodeError) as error:
        raise SourceError(f"{path} is damaged: {error}; run `vo run` again") from error
    return found


def _on_map(
    truth: Trajectory, entry: Entry, placements: Mapping[int, Similarity]
) -> Trajectory | None:
    """The ground truth where the map has the path."""
    assert entry.evaluation is not None
    segment = int(entry.run.segment_of(entry.evaluation.matched.stamps_ns[:1])[0])
    known, aligned = placements.get(segment), entry.evaluation.alignment.reference_from_estimate
    if known is None:
        return None
    rotation = aligned.rotation.T
    scale = 1.0 / aligned.scale
    back = Similarity(scale, rotation, -scale * rotation @ aligned.translation)
    return Trajectory(
        truth.stamps_ns, known.transform_poses(back.transform_poses(truth.world_from_cam))
    )


def _shown(entry: Entry, placements: Mapping[int, Similarity]) -> ShownPath:
    path = entry.run.trajectory
    number = entry.run.segment_of(path.stamps_ns)
    poses = np.full_like(path.world_from_cam, np.nan)
    covariance = np.full((len(path), 6, 6), np.nan)
    for segment, placement in placements.items():
        rows = number == segment
        poses[rows] = placement.transform_poses(path.world_from_cam[rows])
        covariance[rows] = _covariances(entry, segment, path.stamps_ns[rows], placement.scale)
    error = np.full(len(path), np.nan)
    for each in (entry.evaluation, *entry.others):
        if each is not None:
            rows = np.searchsorted(path.stamps_ns, each.matched.stamps_ns)
            error[np.minimum(rows, len(error) - 1)] = each.ate.translation_m
    kept = np.isfinite(poses).all(axis=(1, 2))
    return ShownPath(
        entry, path.stamps_ns[kept], poses[kept], number[kept], error[kept], covariance[kept],
        placements,
    )  # fmt: skip


def _covariances(entry: Entry, segment: int, stamps_ns: Ints, scale: float) -> Floats:
    """Covariances (n, 6, 6) at stamps, linear in time between keyframes; NaN elsewhere."""
    result = np.full((len(stamps_ns), 6, 6), np.nan)
    known = entry.run.sigmas
    if known is None or segment not in known.segment:
        return result
    rows = np.flatnonzero(known.segment == segment)
    times = known.stamp_ns[rows]
    inside = (stamps_ns >= times[0]) & (stamps_ns <= times[-1])
    flat = known.covariance[rows].reshape(-1, 36)
    values = [np.interp(stamps_ns[inside], times, column) for column in flat.T]
    result[inside] = np.stack(values, axis=1).reshape(-1, 6, 6)
    result[:, 3:] *= scale
    result[:, :, 3:] *= scale
    return result


def _deviations(matrices: Floats, covariances: Floats) -> Floats:
    """Standard deviations (N, 3) after a linear map (N, 3, 3)."""
    variances = np.einsum("nij,njk,nik->ni", matrices, covariances, matrices)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


def _angles(rotation: Floats) -> Floats:
    """Heading clockwise from ahead, pitch upwards, roll to the right (N, 3), in radians.

    `rotation`: (N, 3, 3) of the camera against right, ahead and height.
    """
    right, down, forward = rotation[..., 0], rotation[..., 1], rotation[..., 2]
    heading = np.arctan2(forward[:, 0], forward[:, 1])
    pitch = np.arcsin(np.clip(forward[:, 2], -1.0, 1.0))
    return np.stack([heading, pitch, np.arctan2(-right[:, 2], -down[:, 2])], axis=1)
