"""Calibration as a text table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from vo.base.geometry.transforms import rotation_angle
from vo.base.printable import counted
from vo.cli.console import print_table, standard_output
from vo.tools.calibrating.advice import coverage, tilts_deg, warnings_of
from vo.tools.calibrating.calibrate import CalibrationResult
from vo.tools.calibrating.calibration_figures import (
    baseline,
    camera_parameters,
    camera_rms_px,
    epipolar_rms_px,
)


def print_result(
    result: CalibrationResult,
    output: Path,
    picture: Path | None = None,
    console: Console | None = None,
) -> None:
    """Print the cameras, their accuracy, warnings, and the paths of the files."""
    console = console or standard_output()
    for name, value in _facts(result):
        console.print(f"[bold]{name:<9}[/]", escape(value), soft_wrap=True)
    console.print()
    print_table(console, _parameters(result, plain=not console.is_terminal))
    for line in warnings_of(result):
        console.print(f"\nwarning: {line}", markup=False, soft_wrap=True)
    console.print(f"\ncalibration: {output}", markup=False, soft_wrap=True)
    if picture is not None:
        console.print(f"picture: {picture}", markup=False, soft_wrap=True)


def _facts(result: CalibrationResult) -> list[tuple[str, str]]:
    fit, detected = result.fit, result.detected
    left_out = ", ".join(f"frame {n} ({error:.2f} px)" for n, error in sorted(set(fit.dropped)))
    seen = f"board found in {len(detected.views)} of {detected.frames} frames"
    facts = [("board", str(result.board)), ("views", f"{len(fit.frames)} used; {seen}")]
    if left_out or fit.dropped_corners:
        corners = counted(fit.dropped_corners, "single corner")
        facts.append(("outliers", f"{left_out}; {corners}" if left_out else corners))
    for camera in range(detected.cameras):
        lens = fit.lenses[camera]
        others = ", ".join(
            f"{name} {error:.3f}" for name, error in result.compared_rms_px[camera].items()
        )
        facts.append(
            (
                f"cam{camera}",
                f"{lens.distortion_model}, {camera_rms_px(result, camera):.3f} px RMS "
                f"(compared: {others}); "
                f"board in {coverage(result, camera).mean():.0%} of the image, tilted up to "
                f"{tilts_deg(result, camera).max():.0f} degrees",
            )
        )
    return facts + _pair_facts(result)


def _pair_facts(result: CalibrationResult) -> list[tuple[str, str]]:
    transform, sigmas = result.rig.cam1_from_cam0, result.fit.adjustment.sigmas.cam1_from_cam0
    if transform is None or sigmas is None:
        return []
    angle = np.rad2deg(rotation_angle(transform[:3, :3]))
    angle_sigma = np.rad2deg(np.linalg.norm(sigmas[:3]))
    return [
        (
            "pair",
            f"baseline {1000 * baseline(transform):.2f} ± {1000 * sigmas[3]:.2f} mm, rotation "
            f"{angle:.3f} ± {angle_sigma:.3f} degrees",
        ),
        (
            "epipolar",
            f"{epipolar_rms_px(result):.3f} px RMS over {len(result.epipolar_px)} common views",
        ),
    ]


def _parameters(result: CalibrationResult, *, plain: bool) -> Table:
    table = Table(box=None if plain else box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("camera", no_wrap=True)
    table.add_column("parameter", no_wrap=True)
    for name in ("value", "sigma"):
        table.add_column(name, justify="right", no_wrap=True)
    for camera in range(result.detected.cameras):
        for name, value, sigma in camera_parameters(result, camera):
            digits = 6 if name[0] in "kp" else 3
            row = (f"cam{camera}", name, f"{value:.{digits}f}", f"{sigma:.{digits}f}")
            table.add_row(*row)
    return table
