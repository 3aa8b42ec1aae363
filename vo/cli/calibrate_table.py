"""A calibration as a table for people."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from vo.calibrating.advice import coverage, tilts_deg, warnings_of
from vo.calibrating.calibrate import Result
from vo.calibrating.report import baseline, camera_rms_px, epipolar_rms_px, parameters
from vo.geometry.transforms import rotation_angle


def print_result(
    result: Result, output: Path, picture: Path | None = None, console: Console | None = None
) -> None:
    """Print the cameras, how sure they are, what is to be warned of, and where the files are."""
    console = console or Console(highlight=False)
    for name, value in _facts(result):
        console.print(f"[bold]{name:<9}[/]", value, soft_wrap=True)
    console.print()
    console.print(_parameters(result, plain=not console.is_terminal))
    for line in warnings_of(result):
        console.print(f"\nwarning: {line}", markup=False, soft_wrap=True)
    console.print(f"\ncalibration: {output}", markup=False, soft_wrap=True)
    if picture is not None:
        console.print(f"picture: {picture}", markup=False, soft_wrap=True)


def _facts(result: Result) -> list[tuple[str, str]]:
    fit, found = result.fit, result.survey
    left_out = ", ".join(f"frame {n} ({error:.2f} px)" for n, error in sorted(set(fit.dropped)))
    facts = [
        ("board", str(result.board)),
        (
            "views",
            f"{len(fit.frames)} used; {len(found.views)} of {found.frames} frames looked at show "
            "the board",
        ),
    ]
    if left_out or fit.dropped_corners:
        corners = f"{fit.dropped_corners} single corners"
        facts.append(("left out", f"{left_out}; {corners}" if left_out else corners))
    for camera in range(found.cameras):
        lens = fit.lenses[camera]
        others = ", ".join(f"{name} {error:.3f}" for name, error in result.compared[camera].items())
        facts.append(
            (
                f"cam{camera}",
                f"{lens.model}, {camera_rms_px(result, camera):.3f} px RMS (compared: {others}); "
                f"board in {coverage(result, camera).mean():.0%} of the image, tilted up to "
                f"{tilts_deg(result, camera).max():.0f} degrees",
            )
        )
    return facts + _pair_facts(result)


def _pair_facts(result: Result) -> list[tuple[str, str]]:
    transform, sigmas = result.rig.cam1_from_cam0, result.fit.adjusted.sigmas.cam1_from_cam0
    if transform is None or sigmas is None:
        return []
    turn = np.rad2deg(rotation_angle(transform[:3, :3]))
    turn_sigma = np.rad2deg(np.linalg.norm(sigmas[:3]))
    return [
        (
            "pair",
            f"baseline {1000 * baseline(transform):.2f} ± {1000 * sigmas[3]:.2f} mm, turned by "
            f"{turn:.3f} ± {turn_sigma:.3f} degrees",
        ),
        (
            "epipolar",
            f"{epipolar_rms_px(result):.3f} px RMS over {len(result.epipolar_px)} views that both "
            "see",
        ),
    ]


def _parameters(result: Result, *, plain: bool) -> Table:
    table = Table(box=None if plain else box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("camera", no_wrap=True)
    table.add_column("parameter", no_wrap=True)
    for name in ("value", "sigma"):
        table.add_column(name, justify="right", no_wrap=True)
    for camera in range(result.survey.cameras):
        for name, value, sigma in parameters(result, camera):
            digits = 6 if name[0] in "kp" else 3
            row = (f"cam{camera}", name, f"{value:.{digits}f}", f"{sigma:.{digits}f}")
            table.add_row(*row)
    return table
