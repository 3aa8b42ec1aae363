"""Progress bar of the search for the board."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from vo.base.printable import counted

if TYPE_CHECKING:
    from rich.console import Console


@contextmanager
def search_progress(console: Console, total: int) -> Iterator[Callable[[int, int], None]]:
    """A callback with the numbers of frames searched and of views; a bar only on a terminal."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn("{task.fields[found]}"),
        console=console,
        transient=True,
        disable=not console.is_terminal,
        expand=True,
    ) as bar:
        task = bar.add_task("searching for the board", total=total, found="")
        yield lambda done, found: bar.update(task, completed=done, found=counted(found, "view"))
