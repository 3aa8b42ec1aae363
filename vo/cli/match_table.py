"""Two matched images as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from vo.base.geometry.transforms import rotation_angle, so3_log
from vo.base.types import Floats
from vo.cli.console import print_table, standard_output
from vo.tools.pairs.image_pair import ImagePair, PairOptions
from vo.tools.pairs.image_set import ImageSet, PairCounts
from vo.tools.pairs.two_view_records import ModelKind, RelativePose

_STEPS = {"keypoints": "features", "matches": "matching", "model": "geometry"}
_SHOWN = 20  # pairs of a folder


def print_pair(
    pair: ImagePair,
    options: PairOptions,
    names: tuple[str, str],
    written: Sequence[str],
    console: Console | None = None,
) -> None:
    """Print counts, model, motion, the time of each step, and what was written."""
    console = console or standard_output()
    for name, value in _facts(pair, options, names):
        step = _STEPS.get(name)
        time = "" if step is None else f"  [dim]{pair.stage_ms[step]:.1f} ms[/]"
        console.print(f"[bold]{name:<11}[/]", escape(value) + time, soft_wrap=True)
    for path in written:
        console.print(f"[bold]{'written':<11}[/]", escape(path), soft_wrap=True)
    print_failures(pair, console)


def print_set(images: ImageSet, counts: Sequence[PairCounts], written: Sequence[str]) -> None:
    """Print the pairs with most inliers, how many have a model, and what was written."""
    console = standard_output()
    table = Table(box=None)
    for name in ("A", "B", "model"):
        table.add_column(name)
    for name in ("matches", "inliers"):
        table.add_column(name, justify="right")
    best = sorted(counts, key=lambda each: -each.inliers)[:_SHOWN]
    for each in best:
        names = escape(each.image_a), escape(each.image_b), each.model or "–"
        table.add_row(*names, str(each.matches), str(each.inliers))
    print_table(console, table)
    if len(counts) > len(best):
        console.print(f"[dim]{len(best)} of {len(counts)} pairs, those with most inliers[/]")
    related = sum(each.model is not None for each in counts)
    console.print(f"{len(images.names)} images, {related} of {len(counts)} pairs have a model")
    for path in written:
        console.print(escape(path), soft_wrap=True)


def print_failures(pair: ImagePair, console: Console) -> None:
    """Print why there is no model or no motion, or why it is not that of the calibration."""
    if pair.baseline_contradicted:
        console.print(
            "[bold yellow]warning:[/] the matches do not fit the calibrated pair of cameras: "
            "images of different times, or a calibration that is not theirs",
            soft_wrap=True,
        )
    for what, failure in (("model", pair.failure), ("motion", pair.pose_failure)):
        if failure is not None:
            console.print(
                f"[bold red]no {what}:[/]", escape(failure.text), soft_wrap=True, markup=True
            )


def _facts(
    pair: ImagePair, options: PairOptions, names: tuple[str, str]
) -> Iterator[tuple[str, str]]:
    features = options.config.features
    for side, (name, size) in enumerate(zip(names, pair.sizes, strict=True)):
        yield "" if side else "images", f"{name} ({size[0]}x{size[1]})"
    descriptor = "" if features.descriptor == "auto" else f"+{features.descriptor}"
    counts = " and ".join(str(len(each)) for each in pair.keypoints)
    yield "keypoints", f"{counts} ({features.detector}{descriptor})"
    yield "matches", f"{len(pair.matches.query)} ({pair.matcher})"
    fit = pair.fit
    if fit is None:
        return
    count = int(fit.inlier.sum())
    word = "transfer" if fit.kind is ModelKind.HOMOGRAPHY else "epipolar"
    ratio = count / max(len(fit.inlier), 1)
    yield "model", f"{_matrix_name(fit.kind)} ({fit.method})"
    yield "inliers", f"{count} of {len(fit.inlier)} matches ({ratio:.1%})"
    yield "error", f"{fit.symmetric_px:.2f} px (median symmetric {word} error of the inliers)"
    if pair.pose is not None:
        yield from _pose(pair.pose)
    elif pair.cameras is None:
        yield "motion", "unknown without a calibration (--calibration FILE)"


def _matrix_name(kind: ModelKind) -> str:
    return kind.value if kind is ModelKind.HOMOGRAPHY else f"{kind.value} matrix"


def _pose(pose: RelativePose) -> Iterator[tuple[str, str]]:
    yield "rotation", _rotation(pose.second_from_first)
    if not pose.has_translation:
        yield "translation", "none: the camera only turns, or does not move"
        return
    if pose.is_metric:
        x, y, z = _moved(pose.second_from_first).tolist()
        where = f"x {x:+.4f}, y {y:+.4f}, z {z:+.4f} m (of the calibration, which matches confirm)"
        yield "translation", where
        yield "depth", f"{pose.depth_m:.3g} m (median)"
    else:
        yield "translation", _direction(pose.second_from_first)
    yield (
        "parallax",
        f"{pose.parallax_deg:.2f}° (median); {pose.in_front} points in front of both cameras",
    )
    if pose.alternative is not None:
        other = pose.alternative
        yield "or else", f"{_rotation(other)}, {_direction(other)}: a plane allows two motions"


def _rotation(second_from_first: Floats) -> str:
    """Angle, and the rotation vector by axes of the camera."""
    rotation = second_from_first[:3, :3]
    x, y, z = np.rad2deg(so3_log(rotation)).tolist()
    angle = np.rad2deg(rotation_angle(rotation))
    return f"{angle:.2f}° (x {x:+.2f}, y {y:+.2f}, z {z:+.2f})"


def _moved(second_from_first: Floats) -> Floats:
    """(3,) of the second camera in the frame of the first."""
    return np.asarray(-second_from_first[:3, :3].T @ second_from_first[:3, 3])


def _direction(second_from_first: Floats) -> str:
    """Direction in which the camera has moved, in the frame of the first image."""
    x, y, z = _moved(second_from_first).tolist()
    return f"direction x {x:+.3f}, y {y:+.3f}, z {z:+.3f} (length unknown)"
