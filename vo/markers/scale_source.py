"""Markers in a run: the scale of a mono path, and where the markers are."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vo.errors import OutputError
from vo.geometry.cameras import normalise
from vo.geometry.transforms import inverse, quat_xyzw_from_rotation
from vo.markers.boards import check_length
from vo.markers.detection import DictionarySearch, MarkerDetector
from vo.markers.dictionaries import AUTO, dictionary_name
from vo.markers.plane_pose import plane_pose, square_points
from vo.markers.records import DetectedMarker
from vo.markers.scale_fit import MarkerView, PlacedMarker, ScaleFit, fit_scale
from vo.metric_scale import MetricScale, ScaleFindings
from vo.printable import counted
from vo.types import Camera, Estimate, Floats, PlacedFrames, Snapshot, View

MARKERS_FILE = "markers.csv"
MAX_RELATIVE_SIGMA = 0.1
_MIN_GAP_NS = 80_000_000  # between two frames in which markers are searched
_MAX_LENGTH_ERROR = 0.01  # of a path in metres, which is not reported
_MAX_SIGMAS = 3.0
_COLUMNS = (
    *("segment", "id", "tx", "ty", "tz", "qx", "qy", "qz", "qw", "sigma_m"),
    *("views", "first_frame", "last_frame", "error"),
)


@dataclass(frozen=True, eq=False)
class _Found:
    """A marker in a world, and the scale by which it was placed."""

    world: int
    marker: PlacedMarker
    metres_per_unit: float


class MarkerSource:
    """Finds markers during a run, and the scale of each world by them at its end.

    Args:
        length_m: side of the black squares.
        dictionary: as for `vo markers`.
        is_metric: whether the path is in metres already, as in stereo: then only their poses are
            found, and a contradiction is reported.
        origin: id of the marker whose frame becomes that of its world, None for no change.

    Raises:
        ConfigError: an implausible length, or an unknown dictionary.
    """

    def __init__(
        self,
        length_m: float,
        dictionary: str = AUTO,
        *,
        is_metric: bool,
        origin: int | None = None,
    ) -> None:
        check_length(length_m)
        name = dictionary_name(dictionary)
        self._length_m = length_m
        self._is_metric = is_metric
        self._origin = origin
        self._search = DictionarySearch() if name == AUTO else None
        self._detector = None if name == AUTO else MarkerDetector(name)
        self._views: list[MarkerView] = []
        self._searched_ns: int | None = None
        self._repeated: set[int] = set()
        self._found: list[_Found] = []

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        """Search a frame, if it is a keyframe or some time after the last one searched."""
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
        ids = [marker.id for marker in detected]
        self._repeated |= {number for number in ids if ids.count(number) > 1}
        for marker in detected:
            if ids.count(marker.id) == 1:
                self._add(estimate, view, camera, marker)

    def measure(self, path: PlacedFrames) -> ScaleFindings:
        """The scales of all worlds with a marker that was seen from enough sides."""
        notes = [
            f"marker {number} is seen more than once in a frame; such views are not used: give "
            "each marker an id of its own"
            for number in sorted(self._repeated)
        ]
        if not self._views:
            return ScaleFindings((), (*notes, self._unseen()))
        scales: list[MetricScale] = []
        row_of = {number: row for row, number in enumerate(path.frame_index.tolist())}
        poses = path.trajectory.world_from_cam
        for world in sorted(set(path.world.tolist())):
            views = [
                view
                for view in self._views
                if view.frame_index in row_of and path.world[row_of[view.frame_index]] == world
            ]
            if not views:
                continue
            rows = [row_of[view.frame_index] for view in views]
            fit = fit_scale(views, poses[rows], self._length_m, is_metric=self._is_metric)
            scale, note = self._judged(world, fit, len(views))
            scales += [] if scale is None else [scale]
            notes += [note] if note else []
        return ScaleFindings(tuple(scales), tuple(notes))

    def new_worlds(
        self, scales: Mapping[int, MetricScale]
    ) -> tuple[dict[int, Floats], tuple[str, ...]]:
        """New frames of worlds, and why there are none.

        Args:
            scales: by which the worlds have been converted, perhaps those of another source.

        Returns:
            (4, 4) marker_from_world by number of the world, in metres; sentences for the user.
        """
        if self._origin is None:
            return {}, ()
        found = {
            each.world: inverse(_in_metres(each, scales))
            for each in self._found
            if each.marker.id == self._origin
        }
        if found:
            return found, ()
        note = f"marker {self._origin} has no pose in the path, which keeps its world frame"
        return {}, (note,)

    def write(self, folder: Path, scales: Mapping[int, MetricScale]) -> None:
        """Write markers.csv: the markers whose pose in a world is known, in metres.

        Args:
            folder: of the results.
            scales: by which the worlds have been converted, perhaps those of another source.

        Raises:
            OutputError: it cannot be written.
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(_COLUMNS)
        worlds, _ = self.new_worlds(scales)
        for each in self._found:
            pose = worlds.get(each.world, np.eye(4)) @ _in_metres(each, scales)
            writer.writerow(_row(each, pose))
        path = folder / MARKERS_FILE
        try:
            path.write_text(text.getvalue(), encoding="utf-8")
        except OSError as error:
            raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error

    def _add(self, estimate: Estimate, view: View, camera: Camera, marker: DetectedMarker) -> None:
        points = square_points(self._length_m)
        pose = plane_pose(camera, points, marker.corners, marker.sigma_px)
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
            )
        )

    def _judged(
        self, world: int, fit: ScaleFit | None, views: int
    ) -> tuple[MetricScale | None, str]:
        """The scale if it is certain enough, and a sentence if it is not."""
        where = f"in segment {world}"
        if fit is None:
            return None, f"{where} {counted(views, 'view')} of markers are too few for a scale"
        if fit.relative_sigma > MAX_RELATIVE_SIGMA:
            return None, (
                f"the scale cannot be observed by markers {where}: the camera moves too little "
                "while one is in view"
            )
        self._found += [_Found(world, marker, fit.metres_per_unit) for marker in fit.markers]
        error = abs(np.log(fit.metres_per_unit))
        if self._is_metric:
            is_wrong = error > max(_MAX_LENGTH_ERROR, _MAX_SIGMAS * fit.relative_sigma)
            return None, self._contradiction(fit) if is_wrong else ""
        numbers = _listed([marker.id for marker in fit.markers])
        value, sigma = fit.metres_per_unit, fit.metres_per_unit * fit.relative_sigma
        return MetricScale(world, value, sigma, f"markers {numbers}"), ""

    def _contradiction(self, fit: ScaleFit) -> str:
        return (
            f"by the markers of {1000 * self._length_m:g} mm all lengths would be "
            f"{fit.metres_per_unit - 1.0:+.1%} longer: the calibration or --markers is wrong"
        )

    def _unseen(self) -> str:
        name = "any dictionary" if self._detector is None else self._detector.name
        return f"no marker of {name} was seen: they say nothing about the scale"


def _camera(view: View) -> Camera:
    if view.lens is not None:
        return view.lens
    height, width = view.image0.shape
    k = view.camera_matrix
    fx, fy, cx, cy = (float(k[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(width, height, fx, fy, cx, cy)


def _listed(ids: Sequence[int]) -> str:
    return ", ".join(str(number) for number in ids)


def _in_metres(found: _Found, scales: Mapping[int, MetricScale]) -> Floats:
    """world_from_marker (4, 4) in the metres of the path."""
    scale = scales.get(found.world)
    pose = found.marker.world_from_marker.copy()
    pose[:3, 3] *= (1.0 if scale is None else scale.value) / found.metres_per_unit
    return pose


def _row(found: _Found, world_from_marker: Floats) -> Sequence[object]:
    marker = found.marker
    quat = quat_xyzw_from_rotation(world_from_marker[:3, :3])
    texts = [f"{value:.9g}" for value in (*world_from_marker[:3, 3], *quat)]
    ends = (marker.views, marker.first_frame, marker.last_frame, f"{marker.error:.3f}")
    return (found.world, marker.id, *texts, f"{marker.sigma_m:.4g}", *ends)
