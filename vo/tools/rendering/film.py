"""A video of a run: features and matches in the images, and beside them the path as it grows."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.errors import ConfigError, SourceError
from vo.base.failures import describe
from vo.base.geometry.transforms import inverse
from vo.base.records.snapshot import FeatureState, View
from vo.base.types import Bytes, Estimate, Floats, Landmarks, Rig, State, Trajectory
from vo.outputs.evaluation.plots import axes_from_above
from vo.outputs.recorders.reconstruction import dimmed
from vo.outputs.recorders.recorder import NO_FINDINGS, Findings, TakeSnapshot
from vo.outputs.report.run_folder import FrameTable, RunRecord
from vo.tools.drawing import VideoFile, check_video

# Okabe and Ito (2008), as BGR: distinct for all kinds of colour vision.
_GREEN, _SKY, _VERMILION, _YELLOW = (130, 200, 0), (233, 180, 86), (20, 85, 225), (66, 228, 240)
_PAPER, _INK, _FAINT, _GRID = (29, 24, 22), (235, 233, 230), (120, 116, 110), (58, 52, 47)
_FEATURES = {
    FeatureState.NEW: (_SKY, "new"),
    FeatureState.TRACKED: (_GREEN, "agree with the pose"),
    FeatureState.REJECTED: (_VERMILION, "rejected"),
}
_STATES = {State.TRACKING: _GREEN, State.STARTING: _SKY, State.LOST: _VERMILION}
_WIDE = 2.0  # width by height of an image above which the path is below it
_BAR_PX = 62
_MAX_RATE = 60.0  # images per second; of a faster video some are left out
_MAX_POINTS = 30_000  # landmarks from above
_STEPS = 40  # newest frames by which lengths are compared
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class FilmOptions:
    """Size, speed, and part of a video: frames from `start` to before `end`."""

    width: int = 1280
    speed: float = 1.0
    start: int | None = None
    end: int | None = None

    def __post_init__(self) -> None:
        if not 320 <= self.width <= 7680:
            raise ConfigError(f"the width is {self.width}; give 320 to 7680 pixels")
        if not 0.01 <= self.speed <= 1000.0:
            raise ConfigError(f"the speed is {self.speed:g}; give 0.01 to 1000")


class Filmed(NamedTuple):
    """What a video shows; `differing`: frames that were tracked in another way than in the run."""

    output: Path
    images: int
    frames: int
    lost: int
    differing: int
    rate: float


class FilmRecorder:
    """Draws a run that is tracked again; the path is the final one of the run.

    Raises:
        SourceError: the run has no frames; in `record`: the frames are not those of the
            run.
        ConfigError: no frame of the run is in the chosen part.
        OutputError: it is no video; in `record`: it cannot be written.
    """

    def __init__(self, run: RunRecord, output: Path, options: FilmOptions) -> None:
        if run.frames is None or not len(run.frames):
            raise SourceError(f"{run.path} has no frames.csv with frames; run `vo run` again")
        check_video(output)
        self._run, self._output = run, output
        self._table: FrameTable = run.frames
        first, last = int(self._table.frame[0]), int(self._table.frame[-1])
        self._start = first if options.start is None else options.start
        self.end = last + 1 if options.end is None else min(options.end, last + 1)
        if self._start >= self.end:
            raise ConfigError(
                f"no frame of the run is from {self._start} to before {self.end}; it has {first} "
                f"to {last}: choose another `start` or `end`"
            )
        self._width, self._speed = options.width, options.speed
        stamps = run.trajectory.stamps_ns
        self._segments = run.segment_of(stamps)
        self._row_of = {stamp: row for row, stamp in enumerate(stamps.tolist())}
        steps = np.diff(self._table.stamp_ns)
        every = 1e9 / float(np.median(steps)) if len(steps) and np.median(steps) > 0 else 10.0
        self._stride = max(int(np.ceil(every * self._speed / _MAX_RATE)), 1)
        self._rate = every * self._speed / self._stride
        self._reset()

    def _reset(self) -> None:
        self._video = VideoFile(self._output, self._rate)
        self._above: dict[int, _FromAbove] = {}
        self._segment = -1
        self._frames = self._lost = self._differing = 0

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Begin anew: the odometry may track a recording twice."""
        self._video.close()
        self._reset()

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Draw a frame."""
        row = int(np.searchsorted(self._table.frame, estimate.frame_index))
        row = min(row, len(self._table) - 1)
        known = self._table.frame[row], self._table.stamp_ns[row]
        if known != (estimate.frame_index, estimate.stamp_ns):
            raise SourceError(
                f"frame {estimate.frame_index} has the stamp {estimate.stamp_ns} ns, but the run "
                f"has none with it: this is not the recording of {self._run.path}; name its own"
            )
        in_path = self._row_of.get(estimate.stamp_ns)
        if in_path is not None:
            self._segment = int(self._segments[in_path])
        taken = snapshot()
        above = self._view_from_above()
        if above is not None:
            world_from_cam = self._run.trajectory.world_from_cam
            pose = None if in_path is None else world_from_cam[in_path]
            above.add(estimate, pose, taken.landmarks)
        self._frames += 1
        self._lost += estimate.state is State.LOST
        is_same = self._table.state[row] == estimate.state.value
        self._differing += not (is_same and self._table.inliers[row] == estimate.inliers)
        if estimate.frame_index >= self._start and (self._frames - 1) % self._stride == 0:
            self._video.write(self._picture(estimate, taken.view, above))

    def flush(self) -> None:
        """Do nothing."""

    def finish(
        self, causal: Trajectory, smoothed: Trajectory, findings: Findings = NO_FINDINGS
    ) -> None:
        """Finish the file."""
        self._video.close()

    def result(self) -> Filmed:
        """What was drawn."""
        return Filmed(
            self._output, self._video.count, self._frames, self._lost, self._differing, self._rate
        )

    def close(self) -> None:
        """Finish the file, also after an error."""
        self._video.close()

    def _view_from_above(self) -> _FromAbove | None:
        rows = self._segments == self._segment
        if not rows.any():
            return None
        if self._segment not in self._above:
            path = self._run.trajectory
            part = Trajectory(path.stamps_ns[rows], path.world_from_cam[rows])
            self._above[self._segment] = _FromAbove(part, self._run.unit)
        return self._above[self._segment]

    def _picture(self, estimate: Estimate, view: View, above: _FromAbove | None) -> Bytes:
        height, width = view.image0.shape
        is_wide = width > _WIDE * height
        image_width = self._width if is_wide else round(self._width * 0.6)
        factor = image_width / width
        image = draw_view(view, factor)
        beside = (
            (self._width, round(self._width * 0.36))
            if is_wide
            else (self._width - image_width, len(image))
        )
        path = np.full((beside[1], beside[0], 3), _PAPER, np.uint8)
        if above is not None:
            above.draw(path, estimate.stamp_ns)
        color = _STATES[estimate.state]
        cv2.rectangle(image, (0, 0), (image.shape[1] - 1, len(image) - 1), color, 3)
        picture = np.concatenate([image, path], axis=0 if is_wide else 1)
        return np.concatenate([picture, self._bar(estimate)])

    def _bar(self, estimate: Estimate) -> Bytes:
        bar = np.full((_BAR_PX, self._width, 3), _PAPER, np.uint8)
        seconds = (estimate.stamp_ns - self._table.stamp_ns[0]) * 1e-9
        texts = [(estimate.state.value, _STATES[estimate.state])]
        counts = f"{seconds:8.2f} s   frame {estimate.frame_index}"
        if estimate.state is State.TRACKING:
            counts += f"   {estimate.inliers} of {estimate.matches} matches agree"
            counts += "   keyframe" * estimate.is_keyframe
        else:
            counts += f"   {describe(estimate.failure)}"
        texts.append((counts, _INK))
        left = _write(bar, texts, 24)
        key: list[tuple[str, tuple[int, int, int]]] = [
            (f"o {name}", color) for color, name in _FEATURES.values()
        ]
        _write(bar, [*key, ("- match", _YELLOW)], 50)
        if self._speed != 1.0:
            _write(bar, [(f"{self._speed:g} x", _FAINT)], 24, max(left, self._width - 80))
        return bar


def _write(image: Bytes, texts: list[tuple[str, tuple[int, int, int]]], y: int, x: int = 12) -> int:
    """Write texts beside each other, and where the next would be."""
    for text, color in texts:
        # OpenCV's font has ASCII only.
        plain = text.encode("ascii", "replace").decode()
        cv2.putText(image, plain, (x, y), _FONT, 0.55, color, 1, cv2.LINE_AA)
        x += cv2.getTextSize(plain, _FONT, 0.55, 1)[0][0] + 18
    return x


def draw_view(view: View, factor: float) -> Bytes:
    """The image of a view at another size, with its features by state, and matches as lines."""
    grey = dimmed(view.image0, view.masks[0])
    height, width = grey.shape
    size = (round(width * factor), round(height * factor))
    image = np.asarray(cv2.cvtColor(cv2.resize(grey, size), cv2.COLOR_GRAY2BGR), np.uint8)
    xy, before = (
        np.nan_to_num((each + 0.5) * factor - 0.5, nan=-1e4).round().astype(np.int64)
        for each in (view.xy, view.previous_xy)
    )
    radius = max(round(size[0] / 420), 2)
    for state, (color, _) in _FEATURES.items():
        for row in np.flatnonzero(view.feature_state == state):
            if state == FeatureState.TRACKED and before[row, 0] > -1e4:
                cv2.line(image, before[row].tolist(), xy[row].tolist(), _YELLOW, 1, cv2.LINE_AA)
            cv2.circle(image, xy[row].tolist(), radius, color, 1, cv2.LINE_AA)
    return image


class _FromAbove:
    """The path of a segment from above, and the landmarks of the map where they were last seen.

    Landmarks are in the world of the odometry at that time; the newest pose, which both have,
    takes them to that of the final path, and the newest steps tell how lengths differ.
    """

    def __init__(self, path: Trajectory, unit: str) -> None:
        self._stamps_ns, world_from_cam = path.stamps_ns, path.world_from_cam
        self._axes = list(axes_from_above(world_from_cam))
        self._path = world_from_cam[:, :3, 3][:, self._axes]
        self._ahead = world_from_cam[:, :3, 2][:, self._axes]
        self._unit = unit
        self._steps: deque[tuple[Floats, Floats]] = deque(maxlen=_STEPS)
        self._scale = 1.0
        self._ids = np.empty(0, np.int64)
        self._local = self._settled = np.empty((0, 2))

    def add(self, estimate: Estimate, pose: Floats | None, landmarks: Landmarks | None) -> None:
        """Add the landmarks of a frame; `pose`: its final one."""
        causal = estimate.world_from_cam0
        if pose is None or causal is None:
            return
        self._steps.append((causal[:3, 3], pose[:3, 3]))
        lengths = [
            np.linalg.norm(np.diff([each[k] for each in self._steps], axis=0), axis=1).sum()
            for k in (0, 1)
        ]
        if min(lengths) > 0.0:
            self._scale = float(lengths[1] / lengths[0])
        if landmarks is None:
            return
        gone = ~np.isin(self._ids, landmarks.ids)
        self._settled = np.concatenate([self._settled, self._local[gone]])[-_MAX_POINTS:]
        in_cam = landmarks.xyz @ inverse(causal)[:3, :3].T + inverse(causal)[:3, 3]
        placed = self._scale * in_cam @ pose[:3, :3].T + pose[:3, 3]
        self._ids, self._local = landmarks.ids, placed[:, self._axes]

    def draw(self, image: Bytes, stamp_ns: int) -> None:
        """Draw the path up to a time, the landmarks, and a scale bar."""
        height, width = image.shape[:2]
        low, high = self._path.min(axis=0), self._path.max(axis=0)
        # A long path lies along the longer side.
        is_turned = (width > height) != (high[0] - low[0] > high[1] - low[1])
        turn = np.array([[0.0, -1.0], [1.0, 0.0]]) if is_turned else np.eye(2)
        flip = np.array([1.0, -1.0])
        extent = np.maximum(high - low, 0.02 * float((high - low).max() or 1.0))
        extent = np.abs(extent @ turn)
        scale = min(0.74 * width / extent[0], 0.7 * height / extent[1])
        middle = 0.5 * (low + high)

        def pixels(xy: Floats) -> Floats:
            moved = scale * ((xy - middle) @ turn) * flip + [0.5 * width, 0.48 * height]
            return np.asarray(np.clip(moved.round(), -30_000, 30_000).astype(np.int32))

        _draw_points(image, pixels(self._settled), _FAINT)
        _draw_points(image, pixels(self._local), _INK)
        done = int(np.searchsorted(self._stamps_ns, stamp_ns, side="right"))
        path = pixels(self._path)
        cv2.polylines(image, [path], False, _GRID, 1, cv2.LINE_AA)
        if done:
            cv2.polylines(image, [path[:done]], False, _GREEN, 2, cv2.LINE_AA)
            here, ahead = path[done - 1], (self._ahead[done - 1] @ turn) * flip
            ahead = 14.0 * ahead / (float(np.linalg.norm(ahead)) or 1.0)
            cv2.circle(image, path[0].tolist(), 4, _INK, -1, cv2.LINE_AA)
            tip = (here + ahead).round().astype(int)
            cv2.arrowedLine(image, here.tolist(), tip.tolist(), _YELLOW, 2, cv2.LINE_AA, 0, 0.4)
            cv2.circle(image, here.tolist(), 5, _YELLOW, -1, cv2.LINE_AA)
        power = 10.0 ** np.floor(np.log10(0.3 * width / scale))
        bar = max(k * power for k in (1, 2, 5) if k * power <= 0.3 * width / scale)
        left, y = 14, height - 14
        cv2.line(image, (left, y), (left + round(bar * scale), y), _INK, 2)
        _write(image, [(f"{bar:g} {self._unit}", _INK)], y - 8, left)
        _write(image, [("path from above", _FAINT)], 22)


def _draw_points(image: Bytes, xy: Floats, color: tuple[int, int, int]) -> None:
    height, width = image.shape[:2]
    inside = (xy >= 0).all(axis=1) & (xy[:, 0] < width) & (xy[:, 1] < height)
    image[xy[inside, 1], xy[inside, 0]] = color
