"""Runs laps through a rendered room again and again with loops, for `scripts/endurance --laps`.

The end of the laps meets their beginning, so the motion never jumps. Stamps go on, and each frame
has noise of its own, so no image is seen twice. Output folder, frames, preset, mode and the folder
of the rendered laps are the arguments. What memory does is written to `memory.csv` in the folder.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.config import load_config
from vo.base.faults import Fault
from vo.base.geometry.similarity import umeyama
from vo.base.scheduling import share_one_heap
from vo.base.types import Bytes, Frame, Rig, Skipped, Trajectory
from vo.engine.backend.pose_graph import PoseGraph
from vo.engine.memory.recognition import Recognised, Recogniser
from vo.engine.places.records import Place, RegisteredKeyframes
from vo.outputs.evaluation.pose_errors import absolute_errors
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.images import ImageKind
from vo.recordings.sources.registry import open_source
from vo.runs.run_recording import run

COLUMNS = "frame,stored,in_database,loops_found,search_s,graph_poses"
LAPS = (
    *("world=room", "camera=pinhole", "motion=loop", "format=euroc", "scale=0.5"),
    *("seconds=40", "fps=10", "seed=1"),
)
_STEP_NS = 100_000_000
_NOISE_SIGMA, _NOISES = 1.5, 7


class RepeatedLaps:
    """A stream of the frames of a recording, one round after the other.

    `mode`: with `mono`, only the left images are used.
    """

    def __init__(self, recording: Path, frames: int, mode: str) -> None:
        source = open_source(recording, mode="mono" if mode == "mono" else "auto")
        self._images = [frame.images for frame in source.frames()]
        poses = read_tum(recording / "groundtruth.tum").world_from_cam
        every = np.arange(frames)
        self.truth = Trajectory(every * _STEP_NS, poses[every % len(poses)])
        self._count = frames
        self.name, self.format = "repeated laps", source.format
        self.rig: Rig = source.rig
        self.ground_truth: Trajectory | None = None
        self.skipped: list[Skipped] = []
        self.unpaired = 0
        self.faults: list[Fault] = []
        rng = np.random.default_rng(0)
        height, width = source.rig.cameras[0].height, source.rig.cameras[0].width
        shape = (_NOISES, height, width)
        self._noise = np.round(_NOISE_SIGMA * rng.normal(size=shape)).astype(np.int16)
        self._shift = rng.integers(0, width, frames)

    def frames(
        self,
        start: int = 0,
        end: int | None = None,
        stride: int = 1,
        images: ImageKind = "grey",
    ) -> Iterator[Frame]:
        """Grey images at 10 Hz."""
        for index in range(start, self._count if end is None else min(end, self._count), stride):
            chosen = self._images[index % len(self._images)]
            noisy = tuple(
                None if image is None else self._noisy(image, 2 * index + camera)
                for camera, image in enumerate(chosen)
            )
            yield Frame(index, index * _STEP_NS, noisy)

    def _noisy(self, image: Bytes, number: int) -> Bytes:
        noise = np.roll(self._noise[number % _NOISES], self._shift[number // 2], axis=1)
        return np.clip(image.astype(np.int16) + noise, 0, 255).astype(np.uint8)


def main() -> None:
    """Run, with a line of `memory.csv` for each stored keyframe."""
    share_one_heap()  # as the command does
    output, frames, preset, mode, recording = sys.argv[1:]
    folder = Path(output)
    folder.mkdir(parents=True)
    with Path(folder.parent, "memory.csv").open("w", encoding="utf-8", buffering=1) as file:
        file.write(COLUMNS + "\n")
        _observe(file.write)
        config = load_config(preset, ["memory.loops=true", "inertial.enabled=false"])
        laps = RepeatedLaps(Path(recording), int(frames), mode)
        run(laps, folder, config=config)
    print(f"ATE                 {_ate_m(folder, laps.truth, mode):.4f} m")


def _ate_m(folder: Path, truth: Trajectory, mode: str) -> float:
    """RMS error of the path, aligned with a scale in mono."""
    found = read_tum(folder / "trajectory.tum")
    rows = np.searchsorted(truth.stamps_ns, found.stamps_ns)
    similarity = umeyama(found.positions, truth.positions[rows], with_scale=mode == "mono")
    errors = absolute_errors(
        similarity.transform_poses(found.world_from_cam), truth.world_from_cam[rows]
    )
    return float(np.sqrt(np.mean(errors.translation_m**2)))


def _observe(write: Callable[[str], Any]) -> None:
    """Write what each stored keyframe costs, and how much is stored."""
    recognise, result = Recogniser._recognise, PoseGraph.result
    state = {"stored": 0, "loops": 0, "poses": 0}

    def counted(graph: PoseGraph, *arguments: Any) -> RegisteredKeyframes:
        placed = result(graph, *arguments)
        state["poses"] = len(placed.keys)
        return placed

    def observed(recogniser: Recogniser, place: Place, *, searches: bool) -> Recognised:
        begin = time.thread_time()
        found = recognise(recogniser, place, searches=searches)
        spent = time.thread_time() - begin
        state["stored"] += 1
        state["loops"] += len(found.loops)
        write(
            f"{place.frame.index},{state['stored']},{len(recogniser.database)},{state['loops']},"
            f"{spent:.4f},{state['poses']}\n"
        )
        return found

    setattr(PoseGraph, "result", counted)  # noqa: B010, a method of a class is no variable
    setattr(Recogniser, "_recognise", observed)  # noqa: B010


if __name__ == "__main__":
    main()
