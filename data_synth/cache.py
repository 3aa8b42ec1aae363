"""A cache of recordings, by a digest of what they are made from."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

from data_synth.cameras import camera_file
from data_synth.recipe import Recipe, dump_recipe
from data_synth.sequence import make_sequence
from vo.base.errors import OutputError


def cached_sequence(
    recipe: Recipe,
    folder: Path,
    name: str,
    on_frame: Callable[[int, int], None] | None = None,
) -> Path:
    """Path of the recording of a recipe; it is made if it is not in the folder yet.

    Its name contains a digest of the recipe, the camera file and the source code of the generator,
    so that recordings of other settings or of older code are not reused. An existing recording is
    complete, because `make_sequence` renames it into place at the end.

    `folder`: where recordings are kept. `name`: first part of the recording's name. `on_frame`:
    called with the frames done and their total, if it is made.

    Raises:
        ConfigError: the recipe is not feasible.
        OutputError: the folder cannot be written.
    """
    path = folder / f"{name}-{_digest(recipe)}"
    if path.exists():
        return path
    try:
        make_sequence(path, recipe, on_frame=on_frame)
    except OutputError:
        if not path.exists():  # otherwise another process has made it
            raise
    return path


def _digest(recipe: Recipe) -> str:
    text = dump_recipe(recipe).encode() + camera_file(recipe.camera).read_bytes()
    return hashlib.sha256(text + _generator_digest()).hexdigest()[:10]


@cache
def _generator_digest() -> bytes:
    digest = hashlib.sha256()
    home = Path(__file__).parent
    for path in sorted(home.rglob("*.py")):
        digest.update(str(path.relative_to(home)).encode() + path.read_bytes())
    return digest.digest()
