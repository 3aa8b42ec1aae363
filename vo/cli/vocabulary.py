"""`vo vocabulary`: words by which places are recognised."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

from vo.cli import options
from vo.cli.blocks import argument, option
from vo.cli.echo import echo


class VocabularyAction(StrEnum):
    """What to do."""

    TRAIN = "train"


def vocabulary_command(
    action: VocabularyAction = argument(
        "train: make a vocabulary of the images of recordings.", metavar="ACTION"
    ),
    sources: list[Path] = argument("Recordings in any format of `vo run`.", metavar="RECORDING"),
    output: Path = option(
        "Vocabulary to write.", "--output", "-o", metavar="FILE", panel=options.OUTPUT
    ),
    *,
    every: int = option(
        "Use every N-th frame; neighbouring frames are nearly the same.",
        default=10,
        min=1,
        metavar="N",
        panel=options.INPUT,
    ),
    printing: options.Printing,
) -> None:
    """Train a vocabulary of ORB features, by which places are recognised.

    The built-in vocabulary was trained on synthetic recordings. One of your own may recognise more
    places where images differ much from those. Train it with a thousand images or more, of other
    recordings than those it is used on.

      vo vocabulary train monday/ tuesday/ -o mine.words
    """
    from vo.engine.places.vocabulary_file import write_vocabulary
    from vo.outputs.results.output_paths import refuse_to_overwrite
    from vo.tools.laboratory.vocabulary_training import train_on

    def report(name: str, count: int) -> None:
        if not printing.quiet:
            echo(f"{name}: {count} images", err=True)

    refuse_to_overwrite(sources, [output])
    vocabulary = train_on(sources, every, on_recording=report)
    write_vocabulary(output, vocabulary)
    result = {
        "output": str(output),
        "id": vocabulary.id,
        "words": vocabulary.words,
        "images": vocabulary.images,
    }
    text = f"{output}: {vocabulary.words} words of {vocabulary.images} images, {vocabulary.id}"
    printing.show(lambda: result, lambda: echo(text))
