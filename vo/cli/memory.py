"""`vo memory`: what place recognition sees in a run."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

from vo.cli import options
from vo.cli.blocks import argument, option


class MemoryAction(StrEnum):
    """What to do."""

    SHOW = "show"


def memory_command(
    action: MemoryAction = argument(
        "show: similarities of the keyframes of a run by bags of words, and its loops.",
        metavar="ACTION",
    ),
    run: Path = argument("Folder of a run; its recording must be where it was.", metavar="RUN"),
    *,
    picture: Path | None = option(
        "Plot all similarities with the loops, and the images of the first loop with their "
        "matches (.png, .pdf, .svg).",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    ),
    vocabulary: Path | None = option(
        "Vocabulary, from `vo vocabulary train`.",
        default=None,
        metavar="FILE",
        show_default="the built-in one",
        panel=options.INPUT,
    ),
    printing: options.Printing,
) -> None:
    """Show how place recognition compares the keyframes of a run, and the loops that it closed.

    A loop whose keyframes rank first among all others is one that bags of
    words find by themselves; geometry decides which of the first are true.

      vo run house/ -o out/
      vo memory show out/ --picture loops.png
    """
    from vo.cli.echo import echo
    from vo.cli.progress import counting
    from vo.engine.places.vocabulary_file import built_in_vocabulary, read_vocabulary
    from vo.outputs.results.output_paths import refuse_to_overwrite
    from vo.tools.drawing import check_plot
    from vo.tools.laboratory.place_scores import place_scores, save_place_scores

    refuse_to_overwrite([vocabulary, run / "summary.json"], [picture])
    if picture is not None:
        check_plot(picture)
    words = built_in_vocabulary() if vocabulary is None else read_vocabulary(vocabulary)
    with printing.warnings(), counting(printing.errors, run.name, 0) as step:
        found = place_scores(run, words, step)
        if picture is not None:
            save_place_scores(picture, found, run.name)

    def text() -> None:
        echo(f"{len(found.frames)} keyframes, {len(found.loops)} loops")
        if found.loops:
            echo("kind     frame  earlier  score  relative  rank")
        for each in found.loops:
            echo(
                f"{each.kind:<8} {each.frame:>5}  {each.earlier_frame:>7}  {each.score:.3f}  "
                f"{each.relative:>8.2f}  {each.rank:>4}"
            )
        if picture is not None:
            echo(str(picture))

    printing.show(
        lambda: {
            "run": str(run),
            "keyframes": len(found.frames),
            "loops": [each._asdict() for each in found.loops],
            "picture": None if picture is None else str(picture),
        },
        text,
    )
