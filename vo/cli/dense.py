"""`vo dense`: depth, cloud, mesh and grid of a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from vo.cli import options
from vo.cli.blocks import argument, block, option
from vo.cli.echo import echo

if TYPE_CHECKING:
    from vo.tools.dense.fusion import DenseOptions, Densified


@block("Depth")
class DepthChoice:
    """How far, how finely, and what an obstacle is."""

    edge: float | None = option(
        "Edge of the cubes whose points become one, and of the voxels of the mesh.",
        default=None,
        metavar="LENGTH",
        show_default="1 % of the median depth",
    )
    far: float | None = option(
        "Farthest depth.", default=None, metavar="LENGTH", show_default="where its error is 2.2 %"
    )
    segment: int | None = option(
        "Number of the segment.",
        default=None,
        metavar="N",
        min=0,
        show_default="the one with most keyframes",
    )
    cell: float | None = option(
        "Edge of a cell of the grid.", default=None, metavar="LENGTH", show_default="5 cm"
    )
    band: str | None = option(
        "Heights above the ground between which something is an obstacle.",
        default=None,
        metavar="LOW,HIGH",
        show_default="0.15,1.8 m",
    )

    def heights(self) -> tuple[float, float] | None:
        """Both values of `--band`.

        Raises:
            ConfigError: it is no pair of numbers.
        """
        from vo.base.errors import ConfigError

        if self.band is None:
            return None
        try:
            low, high = (float(value) for value in self.band.split(","))
        except ValueError as error:
            raise ConfigError(
                f"--band is {self.band}; give two heights, such as 0.15,1.8"
            ) from error
        return low, high


@block(options.OUTPUT)
class DenseFiles:
    """What is written."""

    output: Path | None = option(
        "Folder of the results.",
        "--output",
        "-o",
        default=None,
        metavar="DIR",
        show_default="RUN/dense",
    )
    no_mesh: bool = option("Do not make a mesh.", "--no-mesh", default=False)
    no_grid: bool = option("Do not make an occupancy grid.", "--no-grid", default=False)
    depth: bool = option(
        "Write the depth of each keyframe, too, as depth/FRAME.tiff.", "--depth", default=False
    )
    cloud: Path | None = option(
        "Write the cloud as .las, .laz or .e57, too.", default=None, metavar="FILE"
    )
    nerfstudio: Path | None = option(
        "Write undistorted images, masks, the cloud and transforms.json, for NeRFs and splats.",
        default=None,
        metavar="DIR",
    )
    colmap: Path | None = option(
        "The same as a COLMAP model, with the cloud as points.", default=None, metavar="DIR"
    )
    rrd: Path | None = option("Write cloud and mesh for rerun.", default=None, metavar="FILE")

    def options(self, chosen: DepthChoice) -> DenseOptions:
        """The options of `vo.dense`.

        Raises:
            ConfigError: one cannot be.
        """
        from vo.tools.dense.fusion import DenseOptions

        kinds = not self.no_mesh, not self.no_grid
        lengths = chosen.edge, chosen.far, chosen.segment
        band = chosen.heights()
        others = self.cloud, self.nerfstudio, self.colmap, self.rrd
        return DenseOptions(*lengths, *kinds, chosen.cell, band, self.depth, *others)


def dense_command(
    run: Path = argument("Folder of a run.", metavar="RUN"),
    source: str | None = argument(
        "Recording of the run.", default=None, metavar="SOURCE", show_default="where it was"
    ),
    *,
    files: DenseFiles,
    chosen: DepthChoice,
    printing: options.Printing,
) -> None:
    """Depth of a run's keyframes, joined to a cloud, a mesh and a grid.

    Two cameras are matched, depth cameras are taken as they are, and one
    camera is compared with itself at neighbouring keyframes. What no other
    keyframe confirms is left out, so that there are holes where nothing is
    known. Lengths are those of the run. Called again after it was broken
    off, it goes on where it was.

      vo run my_sequence/ -o out/
      vo dense out/

    A grid of 10 cm for a robot that is 60 cm high:

      vo dense out/ --cell 0.1 --band 0.1,0.6 --no-mesh
    """
    given = files.options(chosen)
    done = densify_with_progress(run, files.output, source, given, printing)
    printing.show(lambda: {**done._asdict(), "output": str(done.output)}, lambda: print_dense(done))


def densify_with_progress(
    run: Path,
    output: Path | None,
    source: str | None,
    given: DenseOptions,
    printing: options.Printing,
) -> Densified:
    """Make the results, with a bar, and warn of what is not as one would expect."""
    from vo.cli.progress import frame_bar
    from vo.tools.dense.dense import densify

    with frame_bar(printing.errors, "reading", "depth") as (_, show):
        done = densify(run, output, source, given, progress=show)
    if done.segments > 1:
        echo(
            f"warning: segment {done.segment} of {done.segments} is used; where the others are "
            "is unknown (--segment)",
            err=True,
        )
    if given.grid and not done.ground_found:
        echo(
            "warning: the ground was not found; the grid lies where the lowest points are", err=True
        )
    return done


def print_dense(done: Densified) -> None:
    """Print what was made."""
    mesh = [f"mesh        {done.triangles:,} triangles"] if done.triangles else []
    lines = [
        f"output      {done.output}",
        f"depth       {done.coverage:.0%} of the pixels of {done.keyframes} keyframes, "
        f"to {done.far:.3g} {done.unit}",
        f"cloud       {done.points:,} points, {done.edge:g} {done.unit} apart",
        *mesh,
        f"files       {', '.join(Path(each).name for each in done.files)}",
    ]
    echo("\n".join(lines))
