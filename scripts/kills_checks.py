"""What is left of a run that was stopped: every file is read, and what is missing is named."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

TABLES = ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv", "frames.csv")
HEADINGS = {"poses.csv", "covariance.csv", "frames.csv"}
MAX_BEHIND_S = 1.0  # of a recording, after SIGKILL
_EXPORTS_FROM = 3  # keyframes from which an export has points


@dataclass
class Rest:
    """What a stopped run has left."""

    status: str = ""
    frames: int = 0
    problems: list[str] = field(default_factory=list)


def check(folder: Path, was_killed: bool, frames_per_s: float) -> Rest:
    """Read everything that a run with all exports has left in a folder.

    `folder`: with `out/`, `run.rrd`, `run.mcap`, `map.ply` and `model/`. `was_killed`: whether the
    signal could not be handled. `frames_per_s`: speed of the run, to convert a second to frames.
    """
    rest = Rest()
    problems = rest.problems
    if not (folder / "out" / "summary.json").is_file():
        return rest  # stopped before the first frame
    summary = _read(problems, "summary.json", lambda: _json(folder / "out" / "summary.json"))
    rest.status = "" if summary is None else summary["status"]
    rows = {name: _table(problems, folder / "out", name, was_killed) for name in TABLES}
    rest.frames = rows["frames.csv"]
    posed = rows["causal.tum"]
    is_whole = rest.status == "finished" or not was_killed
    if summary is not None and is_whole:
        if summary["frames"] != rest.frames:
            problems.append(f"summary: {summary['frames']} frames, frames.csv: {rest.frames}")
        if rows["poses.csv"] != rows["trajectory.tum"]:
            problems.append("poses.csv and trajectory.tum differ in length")
        if rows["trajectory.tum"] < posed:
            problems.append(f"trajectory.tum has {rows['trajectory.tum']} of {posed} poses")
    behind = 0 if not was_killed else round(MAX_BEHIND_S * frames_per_s) + 2
    for name, count in (("run.mcap", mcap_poses), ("run.rrd", rrd_frames)):
        found = _read(problems, name, lambda count=count, name=name: count(folder / name))
        wanted = posed if name == "run.mcap" else rest.frames
        if found is not None and found < wanted - behind:
            problems.append(f"{name}: {found} of {wanted} frames")
    points = _read(problems, "map.ply", lambda: ply_points(folder / "map.ply"))
    has_points = rows["covariance.csv"] >= _EXPORTS_FROM
    if points == 0 and has_points and not was_killed:
        problems.append("map.ply has no points")
    images = _read(problems, "model", lambda: colmap_images(folder / "model"))
    if images == 0 and has_points and not was_killed:
        problems.append("model has no images")
    return rest


def mcap_poses(path: Path) -> int:
    """Number of poses that a reader gets before the file ends, complete or not."""
    from mcap.exceptions import EndOfFile
    from mcap.stream_reader import StreamReader

    channels: dict[int, str] = {}
    poses = 0
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if type(record).__name__ == "Channel":
                    channels[record.id] = record.topic
                elif type(record).__name__ == "Message":
                    poses += channels[record.channel_id] == "/pose"
        except EndOfFile:
            pass
    return poses


def rrd_frames(path: Path) -> int:
    """Number of frames up to the newest one in an `.rrd` file."""
    from rerun.chunk import RrdReader

    from vo.outputs.recorders import entities

    newest = -1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the file of a killed run has no index
        chunks = RrdReader(path).stream().to_chunks()
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if entities.FRAME_TIMELINE in batch.schema.names:
            newest = max([newest, *batch[entities.FRAME_TIMELINE].to_pylist()])
    return newest + 1


def ply_points(path: Path) -> int:
    """Number of points of a PLY file, which must be complete."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    words = header.split()
    count = int(words[words.index(b"vertex") + 1])
    if len(body) != 15 * count:
        raise ValueError(f"{len(body)} bytes for {count} points")
    return count


def colmap_images(folder: Path) -> int:
    """Number of images of the first model, whose files must agree with each other."""
    model = folder / "sparse" / "0"
    if not model.exists():
        return 0
    points = {line.split()[0] for line in _lines(model / "points3D.txt")}
    images = _lines(model / "images.txt")
    if len(images) % 2:
        raise ValueError("images.txt ends in an image")
    for header, observations in zip(images[::2], images[1::2], strict=True):
        if not (folder / "images" / header.split()[9]).is_file():
            raise ValueError(f"no image {header.split()[9]}")
        if not set(observations.split()[2::3]) <= points:
            raise ValueError("an observation of a point that does not exist")
    return len(images) // 2


def processes_with(mark: str) -> list[int]:
    """Processes whose environment contains a text."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                environment = (entry / "environ").read_bytes()
                is_alive = b"State:\tZ" not in (entry / "status").read_bytes()
            except OSError:
                continue
            if mark.encode() in environment and is_alive:
                found.append(int(entry.name))
    return found


def _table(problems: list[str], folder: Path, name: str, may_be_partial: bool) -> int:
    """Number of rows of a table, which must end with a whole line."""
    file = folder / name
    if not file.is_file() and may_be_partial:
        file = folder / f"{name}.partial"
    if not file.is_file():
        problems.append(f"{name} is missing")
        return 0
    text = file.read_text(encoding="utf-8")
    if text and not text.endswith("\n"):
        problems.append(f"{file.name} ends in the middle of a line")
    lines = text.splitlines()
    separator = "," if name.endswith(".csv") else " "
    if len({line.count(separator) for line in lines}) > 1:
        problems.append(f"{file.name} has lines of different lengths")
    return len(lines) - (name in HEADINGS)


def _read(problems: list[str], name: str, read: Any) -> Any:
    """The result of reading a file; None, and a problem, if that fails."""
    try:
        return read()
    except Exception as error:  # of any kind: it is what is looked for
        problems.append(f"{name} cannot be read: {type(error).__name__}: {error}")
        return None


def _json(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8")))


def _lines(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8")
    if text and not text.endswith("\n"):
        raise ValueError(f"{path.name} ends in the middle of a line")
    return text.splitlines()
