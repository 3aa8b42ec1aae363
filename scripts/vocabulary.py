"""Trains the vocabulary of the package on synthetic recordings that no test uses.

Each world is rendered with several seeds and cameras, at 2 frames/s, so that the images differ.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from data_synth.cache import cached_sequence
from data_synth.recipe import Recipe, load_recipe
from vo.engine.places.vocabulary_file import BUILT_IN, write_vocabulary
from vo.tools.laboratory.vocabulary_training import train_on

SEED = 900_001  # of the first recording; tests and benchmarks use small numbers
SECONDS = 60
FPS = 2
KINDS = (
    ("room", "handheld", "euroc"),
    ("corridor", "robot", "euroc"),
    ("street", "car", "kitti"),
    ("warehouse", "robot", "pinhole"),
    ("terrain", "drone", "euroc"),
    ("room", "handheld", "phone"),
    ("corridor", "handheld", "pinhole"),
    ("street", "car", "pinhole"),
    ("warehouse", "drone", "euroc"),
)


def recipes(seeds: int) -> list[Recipe]:
    """What to render, `seeds` of each kind."""
    return [
        load_recipe(
            None,
            [
                *(f"world={world}", f"motion={motion}", f"camera={camera}", "mono=true"),
                *(f"seconds={SECONDS}", f"fps={FPS}", "format=folder"),
                f"seed={SEED + len(KINDS) * n + kind}",
            ],
        )
        for n in range(seeds)
        for kind, (world, motion, camera) in enumerate(KINDS)
    ]


def main() -> None:
    """Render what is missing, train, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="recordings of each kind")
    parser.add_argument("--cache", type=Path, default=Path("out/vocabulary"))
    parser.add_argument("-o", "--output", type=Path, default=BUILT_IN)
    arguments = parser.parse_args()
    arguments.cache.mkdir(parents=True, exist_ok=True)
    sources = []
    for recipe in recipes(arguments.seeds):
        name = f"{recipe.world}_{recipe.motion}_{recipe.seed}"
        sources.append(cached_sequence(recipe, arguments.cache, name))
        print(sources[-1], file=sys.stderr)
    vocabulary = train_on(sources, every=1)
    write_vocabulary(arguments.output, vocabulary)
    print(f"{vocabulary.words} words of {vocabulary.images} images: {vocabulary.id}")


if __name__ == "__main__":
    main()
