"""Found markers as text: each one of an image, or one line for each id of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from vo.cli.console import standard_output
from vo.cli.markers_run import MarkersResult
from vo.tools.markers.image_markers import FrameMarkers, Marker, PlanePose


def print_markers(result: MarkersResult, console: Console | None = None) -> None:
    """Print the dictionary, a table, poses of boards, and the written files."""
    console = console or standard_output()
    count = sum(len(frame.markers) for frame in result.frames)
    dictionary = "none found" if result.dictionary is None else result.dictionary
    console.print(f"[bold]{'source':<11}[/]", escape(result.source), soft_wrap=True)
    console.print(f"[bold]{'dictionary':<11}[/]", escape(dictionary), soft_wrap=True)
    seen = sum(bool(frame.markers) for frame in result.frames)
    views = f"{count} views in {seen} of {len(result.frames)} frames"
    console.print(f"[bold]{'markers':<11}[/]", views, soft_wrap=True)
    if count:
        frames = result.frames
        console.print(_of_image(frames[0]) if len(frames) == 1 else _of_recording(frames))
    for line in _boards(result.frames):
        console.print(f"[bold]{'board':<11}[/]", escape(line), soft_wrap=True)
    for path in result.written:
        console.print(f"[bold]{'written':<11}[/]", escape(str(path)), soft_wrap=True)


def _of_image(frame: FrameMarkers) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("id", "side px", "x m", "y m", "z m", "± mm", "± deg", "error px", "pose"):
        table.add_column(heading, justify="left" if heading == "pose" else "right")
    for marker in frame.markers:
        table.add_row(str(marker.id), f"{marker.detected.side_px:.1f}", *_pose(marker.pose))
    return table


def _pose(pose: PlanePose | None) -> Sequence[str]:
    if pose is None:
        return (*["-"] * 6, "none")
    x, y, z = pose.cam_from_marker[:3, 3].tolist()
    kind = "ambiguous" if pose.is_ambiguous else "clear"
    sigmas = f"{1e3 * pose.sigma_m:.2f}", f"{pose.sigma_deg:.2f}"
    return f"{x:.4f}", f"{y:.4f}", f"{z:.4f}", *sigmas, f"{pose.error_px:.3f}", kind


def _of_recording(frames: Sequence[FrameMarkers]) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("id", "views", "first", "last", "distance m", "± mm", "error px", "ambiguous"):
        table.add_column(heading, justify="right")
    views: dict[int, list[tuple[int, Marker]]] = {}
    for frame in frames:
        for marker in frame.markers:
            views.setdefault(marker.id, []).append((frame.frame_index, marker))
    for number in sorted(views):
        seen = views[number]
        poses = [marker.pose for _, marker in seen if marker.pose is not None]
        ends = (str(seen[0][0]), str(seen[-1][0]))
        table.add_row(str(number), str(len(seen)), *ends, *_summary(poses))
    return table


def _summary(poses: Sequence[PlanePose]) -> Sequence[str]:
    if not poses:
        return ["-"] * 4
    distances = [pose.distance_m for pose in poses]
    sigma = 1e3 * float(np.median([pose.sigma_m for pose in poses]))
    error = float(np.median([pose.error_px for pose in poses]))
    ambiguous = sum(pose.is_ambiguous for pose in poses)
    reach = f"{min(distances):.2f} to {max(distances):.2f}"
    return reach, f"{sigma:.2f}", f"{error:.3f}", str(ambiguous)


def _boards(frames: Sequence[FrameMarkers]) -> Iterator[str]:
    poses = [frame.board for frame in frames if frame.board is not None]
    if len(frames) == 1 and poses:
        x, y, z = poses[0].cam_from_marker[:3, 3].tolist()
        sigma = 1e3 * poses[0].sigma_m
        yield f"at {x:.4f}, {y:.4f}, {z:.4f} m, ± {sigma:.2f} mm, error {poses[0].error_px:.3f} px"
    elif poses:
        yield f"its pose in {len(poses)} of {len(frames)} frames"
