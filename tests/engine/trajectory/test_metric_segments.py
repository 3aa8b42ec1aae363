"""Which segments are in metres: segments 1 and 2 are in world 1 here, the others in their own."""

from __future__ import annotations

import pytest

from vo.base.records.metric_scale import MetricScale
from vo.engine.trajectory.metric_segments import MetricSegments


def _segments(*, by_cameras: bool = False) -> MetricSegments:
    return MetricSegments(
        by_cameras=by_cameras, world_of=lambda segment: {2: 1}.get(segment, segment)
    )


@pytest.mark.parametrize("source", ["sensor", "map", "scale"])
def test_a_source_of_one_segment_makes_its_world_metric(source: str) -> None:
    metric = _segments()
    assert not any(metric.is_metric(segment) for segment in range(4))
    if source == "sensor":
        metric.by_sensor.add(2)
    elif source == "map":
        metric.by_map = (1,)
    else:
        metric.scales = {1: MetricScale(1, 2.0, 0.1, "gps")}
    assert [metric.is_metric(segment) for segment in range(4)] == [False, True, True, False]
    assert metric.worlds_by_sensor == ({1} if source == "sensor" else set())
    assert (metric.scale(2) is not None) == (source == "scale") and metric.scale(0) is None


def test_with_cameras_that_measure_metres_all_are_metric() -> None:
    assert all(_segments(by_cameras=True).is_metric(segment) for segment in range(4))
