"""How similar the places of a run look to place recognition, and the loops that it closed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from vo.base.config import load_config
from vo.base.errors import SourceError
from vo.base.types import Bytes, Floats, Ints
from vo.engine.features.extractor import make_extractor
from vo.engine.places.vocabulary import Bag, Vocabulary, similarity
from vo.outputs.report.run_folder import read_run
from vo.tools.drawing import check_plot, saved_figure
from vo.tools.pairs.image_pair import PairOptions, match_images
from vo.tools.pairs.pair_picture import draw_pair
from vo.tools.reopening import recording_of

_MAX_KEYFRAMES = 500
_NEIGHBOURS = 5  # keyframes before and after, which look alike anyway
_LOOP, _BEST = "#D55E00", 40  # colour of loops; matches drawn


class PlaceLoop(NamedTuple):
    """A loop of a run, by bags of words.

    Attributes:
        score: L1 similarity of both keyframes, 0 to 1.
        relative: by that of the keyframe with the one before it.
        rank: of the earlier keyframe among all that are no neighbours, 1 for the most similar.
    """

    kind: str
    frame: int
    earlier_frame: int
    score: float
    relative: float
    rank: int


@dataclass(frozen=True, eq=False)
class PlaceScores:
    """Scores (N, N) of N keyframes by their frame numbers, and the loops."""

    frames: Ints
    scores: Floats
    loops: tuple[PlaceLoop, ...]
    images: tuple[Bytes, Bytes] | None  # of the first loop: earlier and later


def place_scores(
    run: Path, vocabulary: Vocabulary, progress: Callable[[str], None] = lambda _: None
) -> PlaceScores:
    """Bags of words of the keyframes of a run, compared with each other.

    Raises:
        SourceError: the run or its recording is missing, or it has less than two keyframes.
    """
    record = read_run(run)
    loops = [each for each in record.summary.get("loops", ()) if each["kind"] != "session"]
    ends = {int(each[key]) for each in loops for key in ("frame", "earlier_frame")}
    frames = _keyframes(record.frames, ends, run)
    extractor = make_extractor(load_config("default").features)
    recording = recording_of(record)
    bags: dict[int, Bag] = {}
    wanted = set(frames)
    first = loops[0] if loops else None
    shown: dict[int, Bytes] = {}
    for number in frames:
        progress(f"frame {number}")
        for frame in recording.frames(number, number + 1):
            if frame.index in wanted and frame.images[0] is not None:
                bags[number] = vocabulary.bag(extractor.extract(frame.image0).descriptor)
                if first is not None and number in (first["frame"], first["earlier_frame"]):
                    shown[number] = frame.image0
    numbers = sorted(bags)
    scores = np.array([[similarity(bags[a], bags[b]) for b in numbers] for a in numbers])
    row = {number: at for at, number in enumerate(numbers)}
    found = [
        _loop(each, scores, row)
        for each in loops
        if {each["frame"], each["earlier_frame"]} <= row.keys()
    ]
    pair = None
    if first is not None and len(shown) == 2:
        pair = shown[first["earlier_frame"]], shown[first["frame"]]
    return PlaceScores(np.array(numbers, np.int64), scores, tuple(found), pair)


def _keyframes(table: Any, ends: set[int], run: Path) -> list[int]:
    if table is None or int((table.keyframe > 0).sum()) < 2:
        raise SourceError(f"{run} has no keyframes to compare; run `vo run` again")
    numbers = np.asarray(table.frame[table.keyframe > 0], dtype=np.int64)
    step = -(-len(numbers) // _MAX_KEYFRAMES)
    return sorted({*numbers[::step].tolist(), *ends})


def _loop(each: Any, scores: Floats, row: dict[int, int]) -> PlaceLoop:
    later, earlier = row[each["frame"]], row[each["earlier_frame"]]
    score = float(scores[later, earlier])
    others = np.delete(
        scores[later],
        np.arange(max(0, later - _NEIGHBOURS), min(len(scores), later + _NEIGHBOURS + 1)),
    )
    rank = 1 + int((others > score).sum())
    before = float(scores[later, max(later - 1, 0)])
    relative = score / before if before > 0 else 0.0
    return PlaceLoop(each["kind"], each["frame"], each["earlier_frame"], score, relative, rank)


def save_place_scores(path: Path, found: PlaceScores, title: str) -> None:
    """Plot the scores, with circles at loops, and the images of the first loop with their matches.

    Raises:
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    check_plot(path)
    with saved_figure(path, 8.0, 10.5 if found.images else 7.0, dpi=110) as figure:
        rows = 2 if found.images else 1
        axes = figure.subplots(rows, 1, squeeze=False, height_ratios=[2.6, 1.0][:rows])[:, 0]
        shown = found.scores.copy()
        np.fill_diagonal(shown, np.nan)
        low, high = np.nanquantile(shown, (0.05, 0.999))
        image = axes[0].imshow(shown, cmap="cividis", vmin=float(low), vmax=float(high))
        figure.colorbar(image, ax=axes[0], label="similarity of bags of words")
        row = {int(number): at for at, number in enumerate(found.frames)}
        ends = np.array([[row[each.earlier_frame], row[each.frame]] for each in found.loops])
        if len(ends):
            axes[0].scatter(*ends.T, s=60, facecolors="none", edgecolors=_LOOP, label="loops")
            axes[0].legend(loc="upper right")
        ticks = np.linspace(0, len(found.frames) - 1, 7).astype(int)
        axes[0].set_xticks(ticks, [str(found.frames[at]) for at in ticks])
        axes[0].set_yticks(ticks, [str(found.frames[at]) for at in ticks])
        axes[0].set_xlabel("frame")
        axes[0].set_ylabel("frame")
        axes[0].set_title(title, parse_math=False)
        if found.images is not None:
            loop = found.loops[0]
            pair = match_images(found.images, PairOptions(load_config("default")))
            picture = draw_pair(found.images, pair, best=_BEST)
            axes[1].imshow(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
            axes[1].set_axis_off()
            axes[1].set_title(
                f"frames {loop.earlier_frame} and {loop.frame}: {int(pair.inlier.sum())} of "
                f"{len(pair.inlier)} matches are inliers"
            )
