"""What the odometry calls of a memory, and a run without one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from vo.closed_loops import ClosedLoop, MapUse, Relocalisation
from vo.errors import OutputError
from vo.inertial_use import InertialUse
from vo.mapping.local_map import LocalMap
from vo.metric_scale import MetricScale


class MapMemory(Protocol):
    """A `KeyframeStore` of the local map that works beside tracking, without changing it."""

    @property
    def closed_loops(self) -> tuple[ClosedLoop, ...]:
        """Loops that were closed so far."""
        ...

    @property
    def relocalisations(self) -> tuple[Relocalisation, ...]:
        """Segments whose place in an older world was found while the camera was in them."""
        ...

    @property
    def map_use(self) -> MapUse | None:
        """The loaded map, None without one."""
        ...

    @property
    def inertial(self) -> InertialUse | None:
        """What became of the inertial sensor, None without one."""
        ...

    def is_metric(self, segment: int) -> bool:
        """Whether an inertial sensor has given lengths of a segment of one camera the metre."""
        ...

    def begin_frame(self, index: int, segment: int, local_map: LocalMap) -> None:
        """Before a frame is tracked, after all updates of the map of its segment."""
        ...

    def forget_from(self, frame_index: int) -> None:
        """Forget all keyframes from a frame on, which are tracked anew."""
        ...

    def finish(self, local_map: LocalMap) -> None:
        """After the last frame: store the keyframes of the local map, and apply all results."""
        ...

    def check_savable(self, path: Path) -> None:
        """Check before the first frame that there will be one map to save.

        Raises:
            OutputError: there will be none, or the loaded map is of another camera.
        """
        ...

    def save_map(self, path: Path, source: str, scales: Mapping[int, MetricScale]) -> None:
        """Write the stored keyframes and where they are to a file, after `finish`.

        Args:
            path: the file.
            source: name of the recording.
            scales: by number of the world, to write those in metres.

        Raises:
            OutputError: the file cannot be written; errors of `check_savable`.
        """
        ...

    def close(self) -> None:
        """End threads and processes."""
        ...


class NoMemory:
    """Forgets everything."""

    closed_loops: tuple[ClosedLoop, ...] = ()
    relocalisations: tuple[Relocalisation, ...] = ()
    map_use: MapUse | None = None

    @property
    def inertial(self) -> InertialUse | None:
        """None."""
        return None

    def is_metric(self, segment: int) -> bool:
        """Never."""
        return False

    def begin_frame(self, index: int, segment: int, local_map: LocalMap) -> None:
        """Nothing to do."""

    def forget_from(self, frame_index: int) -> None:
        """Nothing to forget."""

    def finish(self, local_map: LocalMap) -> None:
        """Nothing to store."""

    def save_map(self, path: Path, source: str, scales: Mapping[int, MetricScale]) -> None:
        """Nothing to save; errors as for `check_savable`."""
        self.check_savable(path)

    def check_savable(self, path: Path) -> None:
        """Nothing to save.

        Raises:
            OutputError: always.
        """
        raise OutputError(f"there is no map to save to {path}: loops are not closed; use --loops")

    def close(self) -> None:
        """Nothing to end."""
