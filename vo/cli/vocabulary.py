"""`vo vocabulary`: words by which places are recognised."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from vo.cli import options
from vo.cli.echo import echo


class VocabularyAction(StrEnum):
    """What to do."""

    TRAIN = "train"


Action = Annotated[
    VocabularyAction,
    typer.Argument(metavar="ACTION", help="train: make a vocabulary of the images of recordings."),
]
Sources = Annotated[
    list[Path], typer.Argument(metavar="RECORDING", help="Recordings in any format of `vo run`.")
]
Output = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="Vocabulary to write.",
        rich_help_panel=options.OUTPUT,
    ),
]
Every = Annotated[
    int,
    typer.Option(
        min=1,
        metavar="N",
        help="Use every N-th frame; neighbouring frames are nearly the same.",
        rich_help_panel=options.INPUT,
    ),
]


def vocabulary_command(
    action: Action,
    sources: Sources,
    output: Output,
    *,
    every: Every = 10,
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
