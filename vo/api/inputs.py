"""Checks and conversions of what callers of the library give."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.config import Config, load_config
from vo.base.errors import CalibrationError, ConfigError, InputError
from vo.base.images.given_images import (
    ColourOrder,
    array_of,
    check_colour,
    image_array,
    in_grey,
    kind_of,
    shown,
)
from vo.base.images.grey_stretch import Pixels, RunningStretch
from vo.base.printable import counted
from vo.base.types import Bytes, Camera, Floats32, Frame, Rig
from vo.outputs.results.summary import mode_of
from vo.recordings.formats.calibration import Calibration, read_calibration

_MAX_STAMP_NS = 2**63 - 1
_MAX_DEPTH_M = 1e6
_MILLIMETRES = np.float32(1e-3)


def calibration_of(given: Calibration | Rig | str | Path) -> Calibration | Rig:
    """A calibration, its file, or the cameras; raises `CalibrationError` and `ConfigError`."""
    if isinstance(given, str | Path):
        return read_calibration(given)
    if not isinstance(given, Calibration | Rig):
        raise ConfigError(
            f"calibration is {kind_of(given)}; give a file, vo.read_calibration(file), the "
            "rig of vo.open(recording), or a vo.Rig"
        )
    return given


def rig_of(calibration: Calibration | Rig | str | Path, mode: str, *, has_depth: bool) -> Rig:
    """The cameras to use.

    Args:
        calibration: a calibration, its file, or the cameras.
        mode: `mono` leaves the right camera out, `stereo` requires it, `auto` takes what there is.
        has_depth: whether there will be depth images; then the right camera is left out.

    Raises:
        CalibrationError: the file cannot be read, or has no right camera in mode `stereo`.
        ConfigError: an argument is of another type, or there is no such mode.
    """
    calibration = calibration_of(calibration)
    rig = calibration.rig if isinstance(calibration, Calibration) else calibration
    if mode not in ("auto", "mono", "stereo"):
        raise ConfigError(f"mode is {shown(mode)}; give 'auto', 'mono' or 'stereo'")
    if mode == "stereo" and not rig.is_stereo:
        raise CalibrationError("mode is 'stereo', but the calibration has one camera only")
    if mode == "stereo" and has_depth:
        raise ConfigError("a pair of cameras does not use depth; leave mode or has_depth out")
    if mode == "stereo":
        rig = rig.first(2)
    if mode == "mono" or has_depth:
        rig = Rig(rig.cam0, has_depth=rig.has_depth or has_depth)
    return rig


def config_of(config: Config | str | Path, overrides: Any, settings: Sequence[str] = ()) -> Config:
    """The settings for frames that are given one by one.

    Raises:
        ConfigError: a setting is unknown or invalid, or frames would be left out.
    """
    if isinstance(overrides, str):
        overrides = [overrides]
    if isinstance(config, Config):
        if settings:
            name = settings[0].partition("=")[0]
            raise ConfigError(
                f"{name} is a setting: give it in the Config, or config as a name or file"
            )
        if overrides:
            raise ConfigError("give overrides with the name of a preset or file, not with a Config")
    elif isinstance(config, str | Path):
        config = load_config(config, [*overrides, *settings])
    else:
        raise ConfigError(f"config is {kind_of(config)}; give a preset, a file or a vo.Config")
    if config.tracking.every != 1:
        raise ConfigError(f"tracking.every is {config.tracking.every}; single frames need 1")
    return config


def stamp_of(value: Any) -> int:
    """A time in nanoseconds; raises `InputError` for what is no whole number of them."""
    if isinstance(value, float | np.floating):
        raise InputError(
            f"stamp_ns is {value!r}, a float; give integer nanoseconds, for seconds "
            "round(1e9 * seconds)"
        )
    if isinstance(value, bool | np.bool_) or not hasattr(value, "__index__"):
        raise InputError(
            f"stamp_ns is {kind_of(value)}; give integer nanoseconds, such as time.time_ns()"
        )
    try:
        stamp = operator.index(value)
    except Exception as error:  # such as of an array, which is no single number
        raise InputError(f"stamp_ns is no integer: {error}") from None
    if not 0 <= stamp <= _MAX_STAMP_NS:
        raise InputError(f"stamp_ns is {stamp}; give nanoseconds from 0 to 2**63 - 1")
    return stamp


class FrameInput:
    """Makes frames of what callers give, and refuses what cannot be meant.

    Args:
        rig: the cameras.
        colour: order of the channels of colour images.

    Raises:
        ConfigError: there is no such order.
    """

    def __init__(self, rig: Rig, colour: ColourOrder) -> None:
        check_colour(colour)
        self._rig = rig
        self._colour = colour
        self._stretch = RunningStretch()
        self._count = 0
        self._last_stamp_ns: int | None = None

    def frame(
        self,
        stamp_ns: Any,
        left: Any,
        right: Any,
        depth: Any,
        mask: Any,
        further: Sequence[Any] = (),
        stamps_ns: Sequence[Any] | None = None,
    ) -> Frame:
        """The next frame, with copies of its images; see `vo.Odometry.track`.

        Raises:
            InputError: a value is of the wrong type, shape or size, or not later than the last.
        """
        stamp = self._stamp(stamp_ns)
        images = self._images(left, right) + self._further(further)
        if all(image is None for image in images):
            raise InputError("left is None, and so are all others; give at least one image")
        times = None if stamps_ns is None else self._times(stamp, stamps_ns)
        frame = Frame(
            self._count,
            stamp,
            images,
            None if depth is None else self._depth(depth),
            mask=None if mask is None else self._mask(mask),
            stamps_ns=times,
        )
        self._count += 1
        self._last_stamp_ns = stamp
        return frame

    def _stamp(self, value: Any) -> int:
        stamp = stamp_of(value)
        if self._last_stamp_ns is not None and stamp <= self._last_stamp_ns:
            raise InputError(
                f"stamp_ns is {stamp}, the frame before had {self._last_stamp_ns}; stamps must "
                "increase: give each frame once, in order"
            )
        return stamp

    def _images(self, left: Any, right: Any) -> tuple[Bytes | None, ...]:
        cam1 = self._rig.cam1
        if right is not None and cam1 is None:
            raise InputError("right is given, but the calibration has one camera only")
        is_missing = left is None and mode_of(self._rig) == "rig"
        pixels = [] if is_missing else [self._pixels(left, "left", self._rig.cam0)]
        if right is not None and cam1 is not None:
            pixels.append(self._pixels(right, "right", cam1))
            if pixels[0].dtype != pixels[-1].dtype:
                raise InputError(
                    f"left is {pixels[0].dtype}, right is {pixels[1].dtype}; give both alike"
                )
        if pixels and pixels[0].dtype == np.uint16:
            self._stretch.update(pixels[0])
        images: list[Bytes | None] = [self._as_8_bits(each) for each in pixels]
        if is_missing:
            images.insert(0, None)
        return (*images, None) if cam1 is not None and right is None else tuple(images)

    def _further(self, given: Sequence[Any]) -> tuple[Bytes | None, ...]:
        """The images of cameras 2, 3 and so on, all None if none is given."""
        lenses = [each.camera for each in self._rig.further]
        if given and len(given) != len(lenses):
            raise InputError(
                f"further has {len(given)} images, but the calibration has "
                f"{counted(len(lenses), 'camera')} besides the first two"
            )
        return tuple(
            None
            if image is None
            else self._as_8_bits(self._pixels(image, f"further[{number}]", lens))
            for number, (image, lens) in enumerate(
                zip(given or [None] * len(lenses), lenses, strict=True)
            )
        )

    def _times(self, stamp_ns: int, given: Sequence[Any]) -> tuple[int, ...]:
        count = len(self._rig.cameras)
        if len(given) != count:
            raise InputError(f"stamps_ns has {len(given)} times for {counted(count, 'camera')}")
        times = tuple(stamp_of(each) for each in given)
        if times[0] != stamp_ns:
            raise InputError(f"stamps_ns begins with {times[0]}, but stamp_ns is {stamp_ns}")
        return times

    def _pixels(self, value: Any, name: str, camera: Camera) -> Pixels:
        """A grey image of 8 or 16 bits, perhaps the given one itself."""
        image = image_array(value, name)
        _check_size(image, name, camera)
        return in_grey(image, self._colour)

    def _as_8_bits(self, image: Pixels) -> Bytes:
        """A copy, since the caller may use its buffer again."""
        if image.dtype == np.uint16:
            return self._stretch.to_8_bits(image)
        return np.array(image, dtype=np.uint8, order="C")

    def _depth(self, value: Any) -> Floats32:
        if not self._rig.has_depth:
            advice = (
                "a pair of cameras does not use it"
                if self._rig.is_stereo
                else "create the odometry with has_depth=True"
            )
            raise InputError(f"depth is given, but not expected; {advice}")
        wanted = "an (H, W) array, float metres or uint16 millimetres"
        depth = array_of(value, "depth", wanted)
        if depth.dtype.kind != "f" and depth.dtype != np.uint16:
            raise InputError(f"depth has pixels of {depth.dtype}; give {wanted}")
        if depth.ndim != 2:
            raise InputError(f"depth has shape {depth.shape}; give {wanted}")
        _check_size(depth, "depth", self._rig.cam0)
        scale = _MILLIMETRES if depth.dtype == np.uint16 else np.float32(1.0)
        with np.errstate(over="ignore", invalid="ignore"):
            metres = depth.astype(np.float32) * scale
            known = (metres > 0) & (metres < _MAX_DEPTH_M)
        return np.ascontiguousarray(np.where(known, metres, np.float32(0.0)))

    def _mask(self, value: Any) -> Bytes:
        wanted = "an (H, W) array of bool or uint8, nonzero where the left image may be used"
        mask = array_of(value, "mask", wanted)
        if mask.dtype not in (np.bool_, np.uint8) or mask.ndim != 2:
            raise InputError(f"mask is {mask.dtype} of shape {mask.shape}; give {wanted}")
        _check_size(mask, "mask", self._rig.cam0)
        return np.where(mask, np.uint8(255), np.uint8(0))


def _check_size(image: Any, name: str, camera: Camera) -> None:
    height, width = image.shape[:2]
    if (width, height) == (camera.width, camera.height):
        return
    turned = (width, height) == (camera.height, camera.width)
    advice = "are rows and columns exchanged?" if turned else "give images as calibrated"
    raise InputError(
        f"{name} has {width}x{height} pixels, the calibration is for "
        f"{camera.width}x{camera.height}; {advice}"
    )
