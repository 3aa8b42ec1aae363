"""Figures of a calibration, for JSON, for the table and for the calibration file."""

from __future__ import annotations

from typing import Any

import numpy as np

from vo.base.types import Camera, Floats
from vo.tools.calibrating.advice import coverage, tilts_deg, warnings_of
from vo.tools.calibrating.calibrate import CalibrationResult


def to_dict(result: CalibrationResult) -> dict[str, Any]:
    """All figures of a calibration, ready for JSON."""
    fit = result.fit
    cameras = {f"cam{number}": _camera(result, number) for number in range(result.detected.cameras)}
    return {
        "board": str(result.board),
        "frames": result.detected.frames,
        "frames_with_board": len(result.detected.views),
        "views": len(fit.frames),
        "dropped_views": [
            {"frame": frame, "rms_px": error} for frame, error in sorted(set(fit.dropped))
        ],
        "dropped_corners": fit.dropped_corners,
        "rms_px": fit.adjustment.rms_px,
        **cameras,
        **_pair(result),
        "warnings": warnings_of(result),
    }


def comments(result: CalibrationResult) -> list[str]:
    """Comments for the calibration file: origin and accuracy."""
    fit = result.fit
    lines = [f"vo calibrate: {result.board}; {len(fit.frames)} views"]
    for number, lens in enumerate(fit.lenses):
        sigmas = ", ".join(
            f"{name} {sigma:.2g}" for name, _, sigma in camera_parameters(result, number)
        )
        error = f"{camera_rms_px(result, number):.3f} px RMS"
        lines.append(f"cam{number}: {lens.name}, {error}; standard deviations: {sigmas}")
    sigma = fit.adjustment.sigmas.cam1_from_cam0
    if sigma is not None:
        turn, shift = (", ".join(f"{value:.2g}" for value in part) for part in _halves(sigma))
        lines.append(
            f"cam1_from_cam0: {epipolar_rms_px(result):.3f} px RMS from epipolar lines; standard "
            f"deviations: rotation {turn} degrees, translation {shift} mm"
        )
    return [*lines, *(f"warning: {line}" for line in warnings_of(result))]


def _halves(sigma: Floats) -> tuple[list[float], list[float]]:
    return np.rad2deg(sigma[:3]).tolist(), (1000.0 * sigma[3:]).tolist()


def camera_rms_px(result: CalibrationResult, camera: int) -> float:
    """RMS reprojection error of a camera, in pixels."""
    squares = [np.sum(residual**2, axis=1) for _, residual in result.observations_of(camera)]
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def camera_parameters(result: CalibrationResult, number: int) -> list[tuple[str, float, float]]:
    """Name, value and standard deviation of a camera's intrinsic parameters."""
    adjustment = result.fit.adjustment
    values, sigmas = (
        each.intrinsics[number].tolist() for each in (adjustment.parameters, adjustment.sigmas)
    )
    return list(zip(result.fit.lenses[number].parameter_names, values, sigmas, strict=True))


def baseline(transform: Floats) -> float:
    """Distance between the cameras in metres."""
    return float(np.linalg.norm(transform[:3, 3]))


def epipolar_rms_px(result: CalibrationResult) -> float:
    """RMS distance of corners from their epipolar lines, in pixels."""
    return float(np.sqrt(np.mean([error**2 for _, error in result.epipolar_px])))


def _camera(result: CalibrationResult, number: int) -> dict[str, Any]:
    camera = result.rig.cam0 if number == 0 else result.rig.cam1
    assert isinstance(camera, Camera)
    fit = result.fit
    return {
        "resolution": [camera.width, camera.height],
        "distortion_model": camera.distortion_model,
        "parameters": {
            name: {"value": value, "sigma": sigma}
            for name, value, sigma in camera_parameters(result, number)
        },
        "rms_px": camera_rms_px(result, number),
        "compared_rms_px": result.compared_rms_px[number],
        "coverage": float(coverage(result, number).mean()),
        "tilt_deg": [round(float(tilt), 2) for tilt in tilts_deg(result, number)],
        "views": [
            {
                "frame": fit.frames[observation.view],
                "corners": len(observation.ids),
                "rms_px": float(np.sqrt(np.mean(np.sum(residual**2, axis=1)))),
            }
            for observation, residual in result.observations_of(number)
        ],
    }


def _pair(result: CalibrationResult) -> dict[str, Any]:
    transform = result.rig.cam1_from_cam0
    sigmas = result.fit.adjustment.sigmas.cam1_from_cam0
    if transform is None or sigmas is None:
        return {}
    return {
        "cam1_from_cam0": transform.tolist(),
        "cam1_from_cam0_sigma": {
            "rotation_deg": np.rad2deg(sigmas[:3]).tolist(),
            "translation_m": sigmas[3:].tolist(),
        },
        "baseline_m": baseline(transform),
        "epipolar_rms_px": epipolar_rms_px(result),
        "epipolar_px": [{"frame": frame, "rms_px": error} for frame, error in result.epipolar_px],
    }
