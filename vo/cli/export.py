"""`vo export`: what a run has seen, for programs that make NeRFs and splats."""

from __future__ import annotations

from pathlib import Path

from vo.cli import options
from vo.cli.blocks import argument, option


def export_command(
    run: Path = argument("Folder of a run.", metavar="RUN"),
    source: str | None = argument(
        "Recording of the run.", default=None, metavar="SOURCE", show_default="where it was"
    ),
    *,
    nerfstudio: Path | None = option(
        "Folder for images, masks, transforms.json and cloud.ply.", default=None, metavar="DIR"
    ),
    colmap: Path | None = option(
        "Folder for images, masks and a COLMAP model.", default=None, metavar="DIR"
    ),
    printing: options.Printing,
) -> None:
    """Images, poses and dense points of a run, for NeRFs and splats.

    Keyframes without distortion, but those that are blurred beside their
    neighbours. Masks hide what moves, as far as its depth tells, and what
    the run's own masks hide. It is `vo dense` without mesh and grid.

      vo run clip.mp4 -o out/
      vo export out/ --nerfstudio splat/
    """
    from vo.base.errors import ConfigError
    from vo.cli.dense import densify_with_progress, print_dense
    from vo.tools.dense.fusion import DenseOptions

    if nerfstudio is None and colmap is None:
        raise ConfigError("nothing is to be written; give `nerfstudio=DIR` or `colmap=DIR`")
    given = DenseOptions(mesh=False, grid=False, nerfstudio=nerfstudio, colmap=colmap)
    done = densify_with_progress(run, nerfstudio or colmap, source, given, printing)
    printing.show(lambda: {**done._asdict(), "output": str(done.output)}, lambda: print_dense(done))
