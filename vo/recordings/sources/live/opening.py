"""Opening of live sources: connection, calibration, and a check that both belong together."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vo.base.errors import CalibrationError, SourceError
from vo.base.types import Mode, Rig
from vo.recordings.formats.calibration import Calibration, ImageSize, read_calibration
from vo.recordings.sources.live.address import LiveAddress, LiveKind
from vo.recordings.sources.live.capture import Capture
from vo.recordings.sources.live.clock import HostClock
from vo.recordings.sources.live.device import CapturedImages, Connect, Device
from vo.recordings.sources.live.opencv_device import open_camera, open_opencv_stream
from vo.recordings.sources.live.pair import PAIR_TOLERANCE_NS, PairedDevices, SideBySideDevice
from vo.recordings.sources.live.stream import LiveFrames

DEFAULT_TIMEOUT_S = 10.0

_log = logging.getLogger(__name__)

_FACTORY_CALIBRATED = {
    LiveKind.REALSENSE: "vo.recordings.sources.live.realsense:RealSense",
    LiveKind.OAK: "vo.recordings.sources.live.oak:Oak",
    LiveKind.ZED: "vo.recordings.sources.live.zed:Zed",
}
"""Stereo cameras with drivers of their own; their packages are imported on demand."""


@dataclass(frozen=True)
class LiveOptions:
    """How a live source is used.

    Attributes:
        timeout_s: time without images after which it ends.
        duration_s: time after which it ends anyway.
        allow_hosts: hosts to which redirects and playlists of HTTP may lead besides its own.
    """

    side_by_side: bool = False
    timeout_s: float = DEFAULT_TIMEOUT_S
    duration_s: float = math.inf
    allow_hosts: Sequence[str] = ()


def open_live(
    address: LiveAddress,
    calibration: Path | None,
    mode: Mode = "auto",
    options: LiveOptions = LiveOptions(),
) -> LiveFrames:
    """Connect to a live source and wait for its first images.

    Raises:
        SourceError: it does not answer, or gives no images.
        CalibrationError: the calibration is missing, or not that of the images.
    """
    name, is_calibrated = address.public_name, address.kind in _FACTORY_CALIBRATED
    if calibration is None and not is_calibrated:
        raise CalibrationError(
            f"{name}: a live camera needs `calibration=FILE`; `vo calibrate` makes one from images "
            "of a chessboard (docs/calibration.md)"
        )
    clock = HostClock()
    connect = (
        _stereo_camera(address, options, clock)
        if is_calibrated
        else _connector(address, _stated_size(calibration), mode, options, clock)
    )
    capture = Capture(name, connect)
    try:
        first = _first_images(name, capture, options.timeout_s)
        height, width = first.images[0].shape
        if calibration is not None:
            chosen = read_calibration(calibration, (width, height))
        else:
            assert capture.rig is not None
            chosen = Calibration(capture.rig)
        rig = _rig(name, chosen, mode, first, options)
        return LiveFrames(
            name, rig, capture, clock, timeout_s=options.timeout_s, duration_s=options.duration_s
        )
    except BaseException:
        capture.close()
        raise


def _stated_size(calibration: Path | None) -> ImageSize | None:
    """The image size that a calibration states, None if it states none."""
    if calibration is None:
        return None
    try:
        camera = read_calibration(calibration).rig.cam0
    except CalibrationError:  # reported when the size of the images is known
        return None
    return camera.width, camera.height


def _connector(
    address: LiveAddress, size: ImageSize | None, mode: Mode, options: LiveOptions, clock: HostClock
) -> Connect:
    """A function that connects to the device or to both."""
    if options.side_by_side and size is not None:
        size = 2 * size[0], size[1]
    is_camera = address.kind is LiveKind.CAMERA

    def single(target: str) -> Connect:
        return lambda: (
            open_camera(target, size, clock) if is_camera else _stream(target, clock, options)
        )

    connects = [single(target) for target in address.targets]
    if options.side_by_side:
        if len(connects) > 1:
            raise SourceError(
                f"{address.public_name}: `side_by_side` is for one device that gives both images"
            )
        return lambda: SideBySideDevice(connects[0]())
    if len(connects) > 1 and mode != "mono":
        _log.warning(
            "%s: nothing synchronises two devices: images up to %.0f ms apart form a pair, which "
            "costs accuracy in fast motion",
            address.public_name,
            1e-6 * PAIR_TOLERANCE_NS,
        )
        return lambda: PairedDevices(address.public_name, *connects)
    return connects[0]


def _stereo_camera(address: LiveAddress, options: LiveOptions, clock: HostClock) -> Connect:
    """A function that connects to a camera with a driver and a calibration of its own."""
    if options.side_by_side:
        raise SourceError(f"{address.public_name} gives two images; leave `side_by_side` out")
    module, _, name = _FACTORY_CALIBRATED[address.kind].partition(":")
    serial = address.targets[0] if address.targets else None

    def connect() -> Device:
        device: Device = getattr(importlib.import_module(module), name)(serial, clock)
        return device

    return connect


def _stream(url: str, clock: HostClock, options: LiveOptions) -> Device:
    """A network stream, through PyAV if it is installed."""
    if importlib.util.find_spec("av") is None:
        return open_opencv_stream(url, clock)
    from vo.recordings.sources.live.pyav_device import PyAvStream

    return PyAvStream(url, clock, options.allow_hosts)


def _first_images(name: str, capture: Capture, timeout_s: float) -> CapturedImages:
    first = capture.take(timeout_s)
    if first is None:
        raise SourceError(f"{name} gives no image for {timeout_s:g} s (`timeout_s` sets this time)")
    return first


def _rig(
    name: str, calibration: Calibration, mode: Mode, first: CapturedImages, options: LiveOptions
) -> Rig:
    """The cameras of the images, after checking their size."""
    rig = calibration.rig
    is_pair = len(first.images) > 1
    if mode == "stereo" and not is_pair:
        raise SourceError(
            f"{name} is one camera; a pair is camera:0,1, or one image with `side_by_side`"
        )
    if is_pair and rig.cam1 is None and mode != "mono":
        raise CalibrationError(
            f"{name}: {calibration.file} has no right camera; add cam1 or use `mode=mono`"
        )
    used = rig if is_pair and mode != "mono" else Rig(rig.cam0)
    for side, camera in enumerate(used.cameras):
        height, width = first.images[side].shape
        if (camera.width, camera.height) != (width, height):
            raise _wrong_size(name, calibration, (width, height), options.side_by_side)
    return used


def _wrong_size(
    name: str, calibration: Calibration, size: ImageSize, is_halved: bool
) -> CalibrationError:
    camera, (width, height) = calibration.rig.cam0, size
    whose = f"{name} gives images of {width}x{height}"
    wanted = f"but {calibration.file} is for {camera.width}x{camera.height}"
    if (camera.width * 2, camera.height) == size and not is_halved:
        return CalibrationError(f"{whose}, {wanted}; give `side_by_side` if both images are in it")
    return CalibrationError(
        f"{whose}, {wanted}; set the camera to that size, or calibrate at {width}x{height}"
    )
