"""Sources of scale from the options of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from vo.errors import ConfigError, SourceError
from vo.metric_scale import ScaleSource
from vo.scaling.position_source import PositionSource
from vo.scaling.positions import read_positions
from vo.sources.source import FrameStream, Recording


@dataclass(frozen=True)
class ScaleOptions:
    """What a run was given to measure its scale.

    Attributes:
        positions: `FILE`, `LOG:/TOPIC` or `auto`, None for no positions.
        offset_ns: added to the times of the positions.
        georeference: whether the path is placed on the globe.
    """

    positions: str | None = None
    offset_ns: int = 0
    georeference: bool = False


class ScaleSources(NamedTuple):
    """All sources of scale of a run; `on_globe` places its path, None for no such files."""

    all: tuple[ScaleSource, ...] = ()
    on_globe: PositionSource | None = None


def make_scale_sources(
    options: ScaleOptions,
    others: Sequence[ScaleSource],
    stream: FrameStream,
    recording: str | None,
) -> ScaleSources:
    """Read and check what measures the scale, before the run.

    Args:
        options: those of the run.
        others: sources of a program of one's own.
        stream: the recording.
        recording: its path, None if it has none.

    Raises:
        ConfigError: options contradict each other or the recording.
        SourceError: positions are missing, damaged or of another time.
    """
    is_metric = stream.rig.is_metric
    if options.positions is None:
        if options.georeference:
            raise ConfigError("--georeference needs positions: give them by --scale-from")
        if options.offset_ns:
            raise ConfigError("--scale-offset is for the positions of --scale-from; give both")
        return ScaleSources(tuple(others))
    positions = read_positions(options.positions, recording).shifted(options.offset_ns)
    if options.georeference and positions.origin is None:
        raise ConfigError(
            f"--georeference needs latitudes and longitudes; {positions.name} has metres"
        )
    source = PositionSource(positions, is_metric=is_metric)
    if isinstance(stream, Recording):
        source.check_times(stream.stamps_ns)
    if len(positions.stamps_ns) < 2:
        raise SourceError(f"{positions.name} has only one position; give at least two")
    return ScaleSources((source, *others), source if options.georeference else None)
