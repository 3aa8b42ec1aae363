"""What the camera of a video, or of photographs, says of itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.recordings.formats.mp4_boxes import read_mp4
from vo.recordings.sources.camera_hint import NO_HINT, camera_hint
from vo.recordings.sources.gopro import open_gopro
from vo.recordings.sources.motion_tracks import MotionTrack, read_motion_track
from vo.tools.inspection.opening import OpenedRecording

_MIN_JITTER = 0.02  # of the interval between frames, of a variable rate


def clip_facts(opened: OpenedRecording) -> tuple[str, ...]:
    """Model, lens, stabilisation, shutter, rotation, rate and positions, as far as known."""
    if not opened.cameras or opened.topics:
        return ()
    shots = opened.cameras[0].shots
    try:
        height, width = shots[0].image.read().shape[:2]
    except SourceError:
        return ()
    hint = camera_hint(opened.path, shots[0].image, (width, height))
    facts = [f"focal length {hint.focal_px:.0f} px by {hint.told_by}"] if hint != NO_HINT else []
    if opened.format != "video":
        return tuple(facts)
    texts, track = read_mp4(opened.path).texts, read_motion_track(opened.path)
    model = " ".join(texts[key] for key in ("make", "model") if key in texts)
    found = [model] if model else []
    found += [*_of_track(track, opened.path, model)] if track is not None else []
    steps = np.diff([shot.stamp_ns for shot in shots])
    if len(steps) and np.abs(steps - np.median(steps)).max() > _MIN_JITTER * np.median(steps):
        facts.append("variable frame rate")
    return (*found, *facts)


def _of_track(track: MotionTrack, path: Path, model: str) -> Iterator[str]:
    if track.model != model:
        yield track.model
    gopro = open_gopro(path)
    if gopro is not None and gopro.text("VFOV"):
        yield f"lens {gopro.text('VFOV')}"
    if track.stabilisation:
        yield f"stabilised ({track.stabilisation})"
    if track.readout_s:
        yield f"rows read within {1e3 * track.readout_s:.3g} ms"
    if gopro is not None and "SHUT" in gopro.streams:
        shut_ms = 1e3 * gopro.streams["SHUT"].rows[:, 0]
        yield f"exposure {shut_ms.min():.2g} to {shut_ms.max():.2g} ms"
    if track.positions is not None:
        yield f"{len(track.positions.stamps_ns)} positions of GPS (`gps=auto`)"
