"""Sources of scale from the options of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from vo.base.errors import ConfigError, SourceError
from vo.base.frozen import frozen
from vo.base.records.metric_scale import ScaleSource
from vo.recordings.sources.source import FrameStream, Recording

if TYPE_CHECKING:  # a run imports what it is given: together they take 30 ms
    from vo.runs.scaling.position_source import PositionSource
    from vo.runs.scaling.wheel_source import WheelSource
    from vo.tools.markers.scale_source import MarkerSource

_MAX_HEIGHT_M = 100.0
_MAX_ARM_M = 50.0


@frozen()
class ScaleOptions:
    """What a run was given to measure its scale.

    Attributes:
        positions: `FILE`, `LOG:/TOPIC` or `auto`, None for no positions: they give the scale.
        gps: the same; they also move the path.
        wheel: wheel odometry: `FILE`, `LOG:/TOPIC` or `auto`, None for none.
        offset_ns: added to the times of the positions.
        georeference: whether the path is placed on the globe.
        height_m: height of the camera above flat ground, None if it is unknown.
        marker_length_m: side of markers that may be in view, None for no search.
        marker_dictionary: theirs, as for `vo markers`.
        world: `marker:ID` for the frame of that marker, None for that of the first camera.
        marker_map: file with markers of known poses, in place of their side.
        lever_arm_m: x, y and z of the sensor of the positions in the frame of the left camera,
            None for a sensor at the camera.
    """

    positions: str | None = None
    gps: str | None = None
    wheel: str | None = None
    offset_ns: int = 0
    georeference: bool = False
    height_m: float | None = None
    marker_length_m: float | None = None
    marker_dictionary: str = "auto"
    world: str | None = None
    marker_map: Path | None = None
    lever_arm_m: tuple[float, float, float] | None = None


class ScaleSources(NamedTuple):
    """All sources of scale of a run.

    `moves` and `wheel` move the path, `on_globe` and `markers` write files.
    """

    all: tuple[ScaleSource, ...] = ()
    moves: PositionSource | None = None
    wheel: WheelSource | None = None
    on_globe: PositionSource | None = None
    markers: MarkerSource | None = None


def make_scale_sources(
    options: ScaleOptions,
    others: Sequence[ScaleSource],
    stream: FrameStream,
    recording: str | None,
    topics: Sequence[str] = (),
) -> ScaleSources:
    """Read and check what measures the scale, before the run.

    Args:
        options: those of the run.
        others: sources of a program of one's own.
        stream: the recording.
        recording: its path, None if it has none.
        topics: options that choose its cameras.

    Raises:
        ConfigError: options contradict each other or the recording.
        SourceError: positions are missing, damaged or of another time.
    """
    is_metric = stream.rig.is_metric
    markers = _markers(options, is_metric=is_metric)
    others = others if markers is None else (markers, *others)
    if options.height_m is not None:
        if is_metric:
            raise ConfigError(
                "`height_m` is for one camera: this recording is in metres already (`mode=mono` "
                "leaves the right camera out)"
            )
        others = (_height_source(options.height_m), *others)
    wheel = _wheel(options, stream, recording, topics)
    others = others if wheel is None else (wheel, *others)
    given = options.positions if options.gps is None else options.gps
    if given is None:
        _check_without_positions(options)
        return ScaleSources(tuple(others), wheel=wheel, markers=markers)
    _check_gps(options)
    from vo.runs.scaling.position_source import PositionSource
    from vo.runs.scaling.positions import read_positions

    positions = read_positions(given, recording).shifted(options.offset_ns)
    if options.georeference and positions.origin is None:
        raise ConfigError(
            f"`georeference` needs latitudes and longitudes; {positions.name} has metres"
        )
    arm = _lever_arm(options)
    source = PositionSource(positions, is_metric=is_metric, lever_arm_m=arm)
    if isinstance(stream, Recording):
        source.check_times(stream.stamps_ns)
    if len(positions.stamps_ns) < 2:
        raise SourceError(f"{positions.name} has only one position; give at least two")
    return ScaleSources(
        (source, *others),
        None if options.gps is None else source,
        wheel,
        source if options.georeference else None,
        markers,
    )


def _height_source(height_m: float) -> ScaleSource:
    from vo.runs.scaling.height_source import HeightSource

    if not 0.0 < height_m <= _MAX_HEIGHT_M:
        raise ConfigError(f"`height_m` is {height_m:g}; give metres above the ground, such as 1.65")
    return HeightSource(height_m)


def _wheel(
    options: ScaleOptions, stream: FrameStream, recording: str | None, topics: Sequence[str]
) -> WheelSource | None:
    if options.wheel is None:
        return None
    from vo.runs.scaling.wheel_odometry import read_wheel
    from vo.runs.scaling.wheel_source import WheelSource

    wheel = WheelSource(
        read_wheel(options.wheel, recording, topics), is_metric=stream.rig.is_metric
    )
    if isinstance(stream, Recording):
        wheel.check_times(stream.stamps_ns)
    return wheel


def _check_without_positions(options: ScaleOptions) -> None:
    if options.georeference:
        raise ConfigError("`georeference` needs positions: give them by `gps`")
    if options.offset_ns:
        raise ConfigError("`offset_ns` is for the positions of `gps`; give both")
    if options.lever_arm_m is not None:
        raise ConfigError("`lever_arm_m` is for the positions of `gps`; give both")


def _check_gps(options: ScaleOptions) -> None:
    if options.gps is None:
        return
    if options.positions is not None:
        raise ConfigError("`gps` gives the scale too; leave `positions` out")
    if options.world is not None or options.marker_map is not None:
        raise ConfigError("`gps` moves the path, and markers place it in their frame; give one")


def _lever_arm(options: ScaleOptions) -> tuple[float, float, float]:
    arm = options.lever_arm_m or (0.0, 0.0, 0.0)
    if not max(abs(value) for value in arm) <= _MAX_ARM_M:
        text = " ".join(f"{value:g}" for value in arm)
        raise ConfigError(f"`lever_arm_m` is {text}; give metres, such as 0.5 -0.8 -1.2")
    return arm


def _markers(options: ScaleOptions, *, is_metric: bool) -> MarkerSource | None:
    length_m, dictionary = options.marker_length_m, options.marker_dictionary
    if options.marker_map is not None or length_m is not None:
        from vo.tools.markers.scale_source import MarkerSource
    if options.marker_map is not None:
        if length_m is not None:
            raise ConfigError("markers have one side, or a map with sides; give one of them")
        if options.world is not None:
            raise ConfigError("`world` is the frame of the map of `marker_map`; leave it out")
        if options.georeference:
            raise ConfigError(
                "`georeference` places the path by positions, and a map of markers in its frame; "
                "leave one of them out"
            )
        from vo.tools.markers.marker_map import read_marker_map

        known = read_marker_map(options.marker_map)
        return MarkerSource(known, dictionary, is_metric=is_metric)
    if length_m is not None:
        origin = None if options.world is None else _marker_of(options)
        return MarkerSource(length_m, dictionary, is_metric=is_metric, origin=origin)
    if options.world is not None:
        raise ConfigError(
            "`world=marker:ID` needs `marker_length_m`, the side of the squares; give both"
        )
    if dictionary != "auto":
        raise ConfigError(
            "`marker_dictionary` is for `marker_length_m`, the side of the squares; give both"
        )
    return None


def _marker_of(options: ScaleOptions) -> int:
    kind, _, number = (options.world or "").partition(":")
    if kind != "marker" or not (number.isascii() and number.isdigit()):
        raise ConfigError(f"`world` is '{options.world}'; give marker:ID, such as marker:7")
    if options.georeference:
        raise ConfigError("`georeference` places the path by positions; leave `world` out")
    return int(number)
