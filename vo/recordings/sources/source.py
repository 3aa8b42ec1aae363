"""Contracts of frame sources: streams, live ones, and recordings, which are of known length."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from vo.base.failures import Gap
from vo.base.faults import Fault
from vo.base.types import Frame, Ints, Rig, Skipped, Trajectory
from vo.recordings.sources.images import ImageKind
from vo.recordings.sources.imu import Imu


@runtime_checkable
class FrameStream(Protocol):
    """Frames of a rig of cameras in time order, without known length or times, such as a camera.

    Attributes:
        rig: the cameras; two only if the frames have images of both.
        ground_truth: true poses of cam0, or None.
        skipped: frames that `frames` could not read so far.
        unpaired: number of frames so far whose image of cam1 is missing, in stereo.
        faults: faults of the whole recording that are known before its first frame.
    """

    name: str
    format: str
    rig: Rig
    ground_truth: Trajectory | None
    skipped: list[Skipped]
    unpaired: int
    faults: list[Fault]

    def frames(
        self, start: int = 0, end: int | None = None, stride: int = 1, images: ImageKind = "grey"
    ) -> Iterator[Frame]:
        """Read frames start, start + stride, ... below end.

        Unreadable frames are left out, with a warning and an entry in `skipped`.
        """
        ...


@runtime_checkable
class Recording(FrameStream, Protocol):
    """A stream whose frames are known beforehand; a log that is being written may still grow.

    Attributes:
        imus: inertial sensors, the preferred one first; their samples are read on request.
    """

    imus: tuple[Imu, ...]

    def __len__(self) -> int:
        """Number of frames."""
        ...

    @property
    def stamps_ns(self) -> Ints:
        """(N,) times of all frames, known without reading an image."""
        ...


@runtime_checkable
class LiveStream(FrameStream, Protocol):
    """A stream that does not wait: of the images that come, the newest is handed out."""

    @property
    def dropped(self) -> int:
        """Number of images so far that were left out, as a newer one came first."""
        ...

    @property
    def gaps(self) -> list[Gap]:
        """Times without images so far, because the connection was lost."""
        ...

    @property
    def unrecorded(self) -> int | None:
        """Number of frames so far that its recording left out; None if it is not recorded."""
        ...

    def now_ns(self) -> int:
        """The present time on the clock of the stamps."""
        ...

    def stop(self) -> None:
        """End `frames` soon; may be called by a signal handler."""
        ...

    def close(self) -> None:
        """Disconnect from the camera."""
        ...
