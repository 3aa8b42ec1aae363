"""Keyframes of a run with their images, as those of ideal pinhole cameras."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.config import load_config
from vo.base.errors import ConfigError, SourceError
from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.geometry.rectification_maps import displaced_maps, wide_maps
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.base.images.recorded_masks import read_masks
from vo.base.types import Bools, Bytes, Floats, Floats32, Frame, with_image0
from vo.outputs.report.run_folder import RunRecord
from vo.recordings.sources.source import Recording
from vo.tools.reopening import poses_of, recording_of

_MAX_LATE_NS = 100_000_000  # of an image of the same recording, whose stamps may be corrected


class KeyframeImages(NamedTuple):
    """A keyframe.

    Attributes:
        frame: its number in the recording.
        stamp_ns: its time.
        world_from_cam: (4, 4) pose of the pinhole camera of `left`.
        left: (H, W) grey.
        right: (H, W) grey, rows as in `left`; None with one camera.
        rgb: (H, W, 3) of `left`, grey if the recording is.
        depth: (H, W) that a depth camera measured, 0 where unknown; None without one.
        mask: (H, W) whether `left` is used; None without masks.
    """

    frame: int
    stamp_ns: int
    world_from_cam: Floats
    left: Bytes
    right: Bytes | None
    rgb: Bytes
    depth: Floats32 | None
    mask: Bools | None


class RunKeyframes:
    """Keyframes of one segment of a run, in time order.

    `segment`: its number, None for the one with most keyframes: what lies between segments is
    unknown, so that they cannot share a cloud.

    Raises:
        SourceError: the run or its recording is missing or damaged.
        ConfigError: the run has no such segment.
    """

    def __init__(self, record: RunRecord, source: str | None, segment: int | None) -> None:
        poses = {k: pose for k, pose in poses_of(record).items() if pose.is_keyframe}
        if not poses:
            raise SourceError(f"{record.path} has no keyframe; its poses are not those of images")
        counts: dict[int, int] = {}
        for pose in poses.values():
            counts[pose.segment] = counts.get(pose.segment, 0) + 1
        if segment is not None and segment not in counts:
            numbers = ", ".join(map(str, sorted(counts)))
            raise ConfigError(f"{record.path} has no segment {segment}; it has {numbers}")
        self.segment = max(counts, key=lambda k: counts[k]) if segment is None else segment
        self.segments = len(counts)
        self._stream: Recording = recording_of(record, source)
        self.rig = _rig_of_run(self._stream, record)
        self._mask = _mask_of_run(self._stream, record)
        to_pinhole = self.rig.cam0_from_rectified
        chosen = {k: pose for k, pose in sorted(poses.items()) if pose.segment == self.segment}
        self.frames = list(chosen)
        self._check_stamps(record.path, [pose.stamp_ns for pose in chosen.values()])
        self.world_from_cam = np.stack([p.world_from_cam0 @ to_pinhole for p in chosen.values()])

    def _check_stamps(self, run: Path, expected_ns: list[int]) -> None:
        stamps_ns = self._stream.stamps_ns
        for frame, expected in zip(self.frames, expected_ns, strict=True):
            found = f"image {frame} at {stamps_ns[frame]} ns" if frame < len(stamps_ns) else "none"
            if found == "none" or abs(int(stamps_ns[frame]) - expected) > _MAX_LATE_NS:
                raise SourceError(
                    f"{self._stream.name} is not the recording of {run}, whose image {frame} is at "
                    f"{expected} ns; here is {found}"
                )

    def __len__(self) -> int:
        return len(self.frames)

    def images(self, first: int = 0) -> Iterator[tuple[int, KeyframeImages]]:
        """Keyframes from row `first` on, with their rows, but those that cannot be read."""
        row = first
        stride = int(np.gcd.reduce(np.diff(self.frames))) if len(self.frames) > 1 else 1
        stream = self._stream.frames(self.frames[first], self.frames[-1] + 1, stride, "colour")
        for frame in with_image0(stream):
            while row < len(self.frames) and self.frames[row] < frame.index:
                row += 1
            if row < len(self.frames) and self.frames[row] == frame.index:
                yield row, self._images(frame, self.world_from_cam[row])

    def _images(self, frame: Frame, world_from_cam: Floats) -> KeyframeImages:
        rig = self.rig
        left = rig.rectify(frame.image0, 0)
        right = None if frame.image1 is None else rig.rectify(frame.image1, 1)
        depth = None if frame.depth is None else rig.rectify_depth(frame.depth)
        pair = _grey(left), None if right is None else _grey(right)
        mask = None
        for each in (self._mask, frame.mask):
            if each is not None:
                used = rig.rectify(each, 0) == 255
                mask = used if mask is None else mask & used
        moment = frame.index, frame.stamp_ns
        return KeyframeImages(*moment, world_from_cam, *pair, _rgb(left), depth, mask)


def _rig_of_run(stream: Recording, record: RunRecord) -> RectifiedRig:
    """The pinhole cameras of the recording, with the errors that the run has found corrected."""
    summary = record.summary
    rig = rectified_rig(stream.rig)
    right = summary.get("right_camera")
    if right is not None:
        turns = {f"{k}_px": np.deg2rad(right[f"{k}_deg"]) * rig.fx for k in ("pitch", "roll")}
        lens = {f"{k}_px": right.get(f"{k}_px", 0.0) for k in ("bend", "skew")}
        zoom_px = 0.01 * right["zoom_percent"] * rig.fx
        rig = rig.with_right_corrected(VerticalDisparity(**turns, **lens, zoom_px=zoom_px))
    if summary.get("lens_error") is not None:
        rig = rig.with_k1_error(summary["lens_error"]["k1"])
    if rig.lens is not None:
        rig = _without_distortion(rig)
    offset, curve = (float(summary.get(f"disparity_{k}_px") or 0.0) for k in ("offset", "curve"))
    return replace(rig, disparity_offset_px=offset, disparity_curve_px=curve)


def _mask_of_run(stream: Recording, record: RunRecord) -> Bytes | None:
    """(H, W) of the recorded images of camera 0, 0 where the run has not used them, or None."""
    path = record.path / "config.yaml"
    if not path.is_file():
        return None
    masks = load_config(path).masks
    return read_masks(stream.rig, masks.files, masks.ignore, masks.roi)[0]


def _without_distortion(rig: RectifiedRig) -> RectifiedRig:
    """The same rig with images remapped to those without its lens."""
    assert rig.lens is not None
    at = wide_maps(rig.lens, np.eye(3), rig.matrix, (rig.width, rig.height))
    u, v = (np.asarray(each, np.float32) for each in cv2.convertMaps(*at, cv2.CV_32FC1))
    sides = [at if maps is None else displaced_maps(maps, u, v) for maps in rig.maps]
    return replace(rig, lens=None, k1_error=0.0, maps=(sides[0], sides[1]))


def _grey(image: Bytes) -> Bytes:
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def _rgb(image: Bytes) -> Bytes:
    code = cv2.COLOR_GRAY2RGB if image.ndim == 2 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), np.uint8)
