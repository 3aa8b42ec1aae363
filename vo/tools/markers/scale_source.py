"""Markers in a run: the scale of a mono path, and where the markers are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from vo.base.errors import ConfigError
from vo.base.geometry.cameras import normalise
from vo.base.geometry.transforms import inverse
from vo.base.printable import counted
from vo.base.records.metric_scale import MetricScale, ScaleFindings
from vo.base.records.posed_frames import PosedFrames
from vo.base.records.seen_markers import MarkerOutline, MarkerSquare, SeenMarkers
from vo.base.records.snapshot import Snapshot, View
from vo.base.types import Camera, Estimate
from vo.engine.markers.dictionaries import AUTO, dictionary_name, smallest_containing
from vo.engine.markers.marker_problem import MarkerView, square_points
from vo.tools.markers.boards import check_length
from vo.tools.markers.detection import DictionarySearch, MarkerDetector
from vo.tools.markers.image_markers import DetectedMarker
from vo.tools.markers.map_fit import fit_map
from vo.tools.markers.marker_map import MarkerMap
from vo.tools.markers.moved import fit_unmoved
from vo.tools.markers.plane_pose import plane_pose
from vo.tools.markers.scale_fit import ScaleFit
from vo.tools.markers.world_frames import (
    FoundMarker,
    NewWorlds,
    frames_of_map,
    frames_of_marker,
    write_markers,
)

MAX_RELATIVE_SIGMA = 0.1
_MIN_GAP_NS = 80_000_000  # between two frames in which markers are searched
_MAX_LENGTH_ERROR = 0.01  # of a path in metres, which is not reported
_MAX_SIGMAS = 3.0
_METRIC_SIGMA = 0.003  # relative, of a path in metres


class MarkerSource:
    """Finds markers during a run, and the scale of each world by them at its end.

    `newest`: markers that the newest frame shows once, and ids that it shows several times.
    `markers`: side of the black squares in metres, or a map; of a map, other markers are left out,
    and its frame becomes that of the worlds that show it. `dictionary`: as for `vo markers`.
    `is_metric`: whether the path is in metres already, as in stereo: then only their poses are
    found, and a contradiction is reported. `origin`: id of the marker whose frame becomes that of
    its world, None for no change.

    Raises:
        ConfigError: an implausible length, or an unknown dictionary.
    """

    def __init__(
        self,
        markers: float | MarkerMap,
        dictionary: str = AUTO,
        *,
        is_metric: bool,
        origin: int | None = None,
    ) -> None:
        self.newest: tuple[list[MarkerView], list[int]] = [], []
        name = dictionary_name(dictionary)
        self._map = markers if isinstance(markers, MarkerMap) else None
        if isinstance(markers, MarkerMap):
            self._lengths_m = {each.id: each.length_m for each in markers.markers.values()}
            name = _common_dictionary(name, markers)
        else:
            check_length(markers)
            self._lengths_m = {}
            self._length_m = markers
        self._is_metric = is_metric
        self._origin = origin
        self._search = DictionarySearch() if name == AUTO else None
        self._detector = None if name == AUTO else MarkerDetector(name)
        self._views: list[MarkerView] = []
        self._outlines: list[MarkerOutline] = []
        self._searched_ns: int | None = None
        self._repeated: set[int] = set()
        self._unknown: set[int] = set()  # seen, and not in the map
        self._found: list[FoundMarker] = []
        self._worlds: list[int] = []

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        """Search a frame, if it is a keyframe or some time after the last one searched."""
        self.newest = [], []
        since = self._searched_ns
        is_due = since is None or estimate.stamp_ns - since >= _MIN_GAP_NS
        if not (is_due or estimate.is_keyframe):
            return
        self._searched_ns = estimate.stamp_ns
        view = snapshot().view
        if self._detector is None:
            assert self._search is not None
            name = self._search.add(view.image0)
            if name is None:
                return
            self._detector = MarkerDetector(name)
        camera = _camera(view)
        detected = self._detector.detect(view.image0, camera)
        frame = estimate.frame_index
        self._outlines += [MarkerOutline(frame, each.id, each.corners) for each in detected]
        ids = [marker.id for marker in detected]
        repeated = sorted({number for number in ids if ids.count(number) > 1})
        self._repeated.update(repeated)
        before = len(self._views)
        for marker in detected:
            if ids.count(marker.id) == 1:
                self._add(estimate, view, camera, marker)
        self.newest = self._views[before:], repeated

    def measure(self, path: PosedFrames) -> ScaleFindings:
        """The scales of all worlds with a marker that was seen from enough sides."""
        notes = [
            f"marker {number} is seen more than once in a frame; such views are not used: give "
            "each marker an id of its own"
            for number in sorted(self._repeated)
        ]
        if self._map is not None and self._unknown:
            numbers = _listed(sorted(self._unknown))
            notes.append(f"markers that are not in {self._map.name} are left out: {numbers}")
        self._worlds = sorted(set(path.world.tolist()))
        if not self._views:
            return ScaleFindings((), (*notes, self._unseen()))
        scales: list[MetricScale] = []
        row_of = {number: row for row, number in enumerate(path.frame_index.tolist())}
        poses = path.trajectory.world_from_cam
        for world in self._worlds:
            views = [
                view
                for view in self._views
                if view.frame_index in row_of and path.world[row_of[view.frame_index]] == world
            ]
            if not views:
                continue
            rows = [row_of[view.frame_index] for view in views]
            steps = np.diff(poses[:, :3, 3], axis=0, prepend=poses[:1, :3, 3])
            along = np.cumsum(np.where(path.world == world, np.linalg.norm(steps, axis=1), 0.0))
            fit, moved = fit_unmoved(views, poses[rows], along[rows], is_metric=self._is_metric)
            scale, untold = self._judged(world, fit, len(views))
            scales += [] if scale is None else [scale]
            notes += [*moved, *untold]
        return ScaleFindings(tuple(scales), tuple(notes))

    def new_worlds(self, scales: Mapping[int, MetricScale]) -> NewWorlds:
        """New frames of worlds, and why there are none.

        `scales`: by which the worlds have been converted, perhaps those of another source.
        """
        if self._map is not None:
            return frames_of_map(self._map, self._found, scales, self._worlds)
        if self._origin is None:
            return NewWorlds()
        return frames_of_marker(self._origin, self._found, scales)

    def write(self, folder: Path, scales: Mapping[int, MetricScale]) -> None:
        """Write markers.csv: the markers whose pose in a world is known, in metres.

        `scales`: by which the worlds have been converted, perhaps those of another source.

        Raises:
            OutputError: it cannot be written.
        """
        name = AUTO if self._detector is None else self._detector.name
        if self._found and self._search is not None:
            name = smallest_containing(name, [each.marker.id for each in self._found])
        worlds = self.new_worlds(scales).poses
        write_markers(folder, self._found, worlds, scales, name)

    def seen(self) -> SeenMarkers:
        """All markers in images, and those whose place was measured, for recordings."""
        squares = []
        for each in self._found:
            marker, units = each.in_metres({}), 1.0 / each.metres_per_unit
            corners = square_points(units * marker.length_m) @ marker.world_from_marker[:3, :3].T
            corners += marker.world_from_marker[:3, 3]
            squares.append(MarkerSquare(marker.id, each.world, marker.first_frame, corners))
        return SeenMarkers(tuple(self._outlines), tuple(squares))

    def _add(self, estimate: Estimate, view: View, camera: Camera, marker: DetectedMarker) -> None:
        length_m = self._length_m if self._map is None else self._lengths_m.get(marker.id)
        if length_m is None:
            self._unknown.add(marker.id)
            return
        points = square_points(length_m)
        pose = plane_pose(camera, points, marker.corners, marker.sigma_px)
        assert self._detector is not None
        if pose is None:
            return
        solutions = (pose.cam_from_marker, *([] if pose.other is None else [pose.other]))
        rotation = np.eye(4) if view.cam0_from_image0 is None else inverse(view.cam0_from_image0)
        sigma = marker.sigma_px / np.array([camera.fx, camera.fy])
        rays = normalise(camera, marker.corners)
        self._views.append(
            MarkerView(
                estimate.frame_index,
                estimate.stamp_ns,
                marker.id,
                rays,
                sigma,
                solutions,
                rotation,
                length_m,
                pose.is_ambiguous,
                self._detector.name,
            )
        )

    def _judged(
        self, world: int, fit: ScaleFit | None, views: int
    ) -> tuple[MetricScale | None, list[str]]:
        """The scale if it is certain enough, and sentences about what is not as it should be."""
        where = f"in segment {world}"
        if fit is None:
            few = f"{where} {counted(views, 'view')} of markers are too few for a scale"
            return None, [few]
        by_sides, notes, used = fit, [], [marker.id for marker in fit.markers]
        if self._map is not None:
            found = self._on_map(fit, self._map)
            if isinstance(found, str):
                return None, [f"{where} the markers contradict their map: {found}"]
            fit, used, told = found
            notes = [f"{where} {text}" for text in told]
        if fit.relative_sigma > MAX_RELATIVE_SIGMA:
            unseen = (
                f"the scale cannot be observed by markers {where}: the camera moves too little "
                "while one is in view"
            )
            return None, [*notes, unseen]
        self._found += [
            FoundMarker(world, marker, by_sides.metres_per_unit, marker.id in used)
            for marker in fit.markers
        ]
        if self._is_metric:
            error = abs(np.log(by_sides.metres_per_unit))
            if error > max(_MAX_LENGTH_ERROR, _MAX_SIGMAS * by_sides.relative_sigma):
                notes.append(self._contradiction(by_sides))
            return None, notes
        value, sigma = fit.metres_per_unit, fit.metres_per_unit * fit.relative_sigma
        return MetricScale(world, value, sigma, f"markers {_listed(used)}"), notes

    def _on_map(
        self, fit: ScaleFit, known: MarkerMap
    ) -> tuple[ScaleFit, list[int], list[str]] | str:
        """The scale with the distances of the map, the markers that agree with it, and sentences.

        Words about the contradiction, if the markers have no place in the map.
        """
        markers, sigma = fit.markers, fit.relative_sigma
        if self._is_metric:
            found = [FoundMarker(0, marker, fit.metres_per_unit) for marker in markers]
            markers, sigma = tuple(each.in_metres({}) for each in found), _METRIC_SIGMA
        on_map = fit_map(markers, known.markers, sigma)
        if isinstance(on_map, str):
            return f"{known.name} {on_map}"
        told = [
            f"marker {number} does not fit {known.name}, where it is {off:.2f} m away or turned: "
            "it is left out"
            for number, off in on_map.refused.items()
        ]
        if on_map.contradicts_sides:
            told.append(
                f"{known.name} has distances between markers that are {on_map.scale - 1.0:+.1%} "
                "longer than by their sides: a length or the map is wrong"
            )
        if self._is_metric:
            return fit, list(on_map.used), told
        metres = fit.metres_per_unit * on_map.scale
        fitted = fit._replace(metres_per_unit=metres, relative_sigma=on_map.relative_sigma)
        return fitted, list(on_map.used), told

    def _contradiction(self, fit: ScaleFit) -> str:
        error = f"{fit.metres_per_unit - 1.0:+.1%}"
        if self._map is not None:
            return (
                f"by the sides of the markers in {self._map.name} all lengths would be {error} "
                "longer: the calibration or these sides are wrong"
            )
        return (
            f"by the markers of {1000 * self._length_m:g} mm all lengths would be {error} longer: "
            "the calibration or `marker_length_m` is wrong"
        )

    def _unseen(self) -> str:
        if self._map is not None:
            return f"no marker of {self._map.name} was seen: the path is not in its frame"
        name = "any dictionary" if self._detector is None else self._detector.name
        return f"no marker of {name} was seen: they say nothing about the scale"


def _common_dictionary(given: str, known: MarkerMap) -> str:
    """The dictionary of an option and a map, `auto` if neither names it."""
    if AUTO in (given, known.dictionary):
        return known.dictionary if given == AUTO else given
    if given != known.dictionary:
        raise ConfigError(
            f"`marker_dictionary` is {given}, and {known.name} has {known.dictionary}; leave the "
            "option out"
        )
    return given


def _camera(view: View) -> Camera:
    if view.lens is not None:
        return view.lens
    height, width = view.image0.shape
    k = view.camera_matrix
    fx, fy, cx, cy = (float(k[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(width, height, fx, fy, cx, cy)


def _listed(ids: Sequence[int]) -> str:
    return ", ".join(str(number) for number in ids)
