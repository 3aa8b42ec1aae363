"""Recognition of places on recordings with ground truth: average precision, and recall.

Each frame is a query against all earlier ones but those of the last 10 s. The one with the highest
score counts as right within 2 m and 30 degrees; a query is a revisit if an earlier frame is. The
results are the average precision of the right ones by raw score, and the recall of revisits at the
lowest score above that of every wrong one.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from vo.base.config import FeaturesConfig
from vo.engine.features.extractor import make_extractor
from vo.engine.places.inverted_index import InvertedIndex
from vo.engine.places.vocabulary_file import built_in_vocabulary, read_vocabulary
from vo.recordings.sources.registry import open_source

MAX_M, MAX_DEG, GAP_S = 2.0, 30.0, 10.0


def main() -> None:
    """Print a line for each recording."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--vocabulary", type=Path)
    parser.add_argument("--every", type=int, default=10, help="use every so many-th frame")
    arguments = parser.parse_args()
    file = arguments.vocabulary
    vocabulary = built_in_vocabulary() if file is None else read_vocabulary(file)
    extractor = make_extractor(FeaturesConfig())
    for path in arguments.recordings:
        recording = open_source(path, mode="mono")
        truth = recording.ground_truth
        assert truth is not None, f"{path} has no ground truth"
        index = InvertedIndex(vocabulary.words)
        stamps, poses, results, revisits = [], [], [], 0
        for frame in recording.frames(0, None, arguments.every):
            row = int(np.argmin(np.abs(truth.stamps_ns - frame.stamp_ns)))
            pose = truth.world_from_cam[row]
            bag = vocabulary.bag(extractor.extract(frame.image0).descriptor)
            early = [n for n, s in enumerate(stamps) if s < frame.stamp_ns - GAP_S * 1e9]
            if early:
                before = np.array(poses)[early]
                distance = np.linalg.norm(before[:, :3, 3] - pose[:3, 3], axis=1)
                trace = np.einsum("nij,ij->n", before[:, :3, :3], pose[:3, :3])
                angle = np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
                right = (distance <= MAX_M) & (angle <= MAX_DEG)
                scores = index.scores(bag)[early]
                best = int(np.argmax(scores))
                revisits += int(right.any())
                results.append((float(scores[best]), bool(right[best])))
            index.add(bag)
            stamps.append(frame.stamp_ns)
            poses.append(pose)
        results.sort(key=lambda r: (-r[0], r[1]))
        is_right = np.array([r[1] for r in results], bool)
        precision = np.cumsum(is_right) / np.arange(1, len(is_right) + 1)
        average = float(precision[is_right].sum()) / max(revisits, 1)
        first_wrong = int(np.argmin(is_right)) if not is_right.all() else len(is_right)
        recall = first_wrong / max(revisits, 1)
        print(
            f"{path.name}: {len(stamps)} frames, {revisits} revisits, "
            f"average precision {average:.2f}, recall at full precision {recall:.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
