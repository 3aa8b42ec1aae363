"""Calls of `vo run` in this process, and small images of noise for them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from typer.testing import CliRunner, Result

from vo.cli.app import app

VO = Path(sys.executable).with_name("vo")
WIDTH, HEIGHT = 96, 64
CALIBRATION = "cam0: {{resolution: [96, 64], intrinsics: [{fx}, 80.0, 47.5, 31.5]}}\n"


def vo_run(source: Path, output: Path, *arguments: object) -> Result:
    words = ["run", source, "--output", output, *arguments]
    return CliRunner().invoke(app, list(map(str, words)))


def summary_in(folder: Path) -> dict[str, Any]:
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(summary, dict)
    return summary


def write_noise(path: Path, seed: int, width: int = WIDTH) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    noise = np.random.default_rng(seed).integers(0, 256, (HEIGHT, width), dtype=np.uint8)
    assert cv2.imwrite(str(path), noise)
