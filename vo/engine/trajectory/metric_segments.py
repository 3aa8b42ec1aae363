"""Which segments of the path are in metres, and by what: the one place that knows."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from vo.base.records.metric_scale import MetricScale


class MetricSegments:
    """Segments in metres: by the cameras, an inertial sensor, a loaded map, or a measured scale.

    Attributes:
        by_cameras: whether all are, with stereo or depth.
        by_sensor: numbers of the segments whose keyframes an inertial sensor has placed in metres.
        fused: numbers of those whose path is that of two cameras and an inertial sensor.
        by_map: numbers of the worlds that are in metres by a loaded map.
        scales: of worlds, and of segments joined later, by which the path was converted at the end.
    """

    def __init__(self, *, by_cameras: bool, world_of: Callable[[int], int]) -> None:
        self.by_cameras = by_cameras
        self.by_sensor: set[int] = set()
        self.fused: set[int] = set()
        self.by_map: tuple[int, ...] = ()
        self.scales: Mapping[int, MetricScale] = {}
        self._world_of = world_of

    @property
    def worlds_by_sensor(self) -> set[int]:
        """Numbers of the worlds with segments that are in metres by the inertial sensor."""
        return {self._world_of(segment) for segment in self.by_sensor}

    @property
    def worlds_with_sensor(self) -> set[int]:
        """Numbers of the worlds in whose path an inertial sensor has a part."""
        return {self._world_of(segment) for segment in self.by_sensor | self.fused}

    def scale(self, segment: int) -> MetricScale | None:
        """The scale by which a segment was converted to metres, None without one."""
        return self.scales.get(segment) or self.scales.get(self._world_of(segment))

    def is_metric(self, segment: int) -> bool:
        """Whether lengths of a segment are metres now."""
        world = self._world_of(segment)
        known = self.by_cameras or world in self.by_map or world in self.scales
        return known or world in self.worlds_by_sensor
