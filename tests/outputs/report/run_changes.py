"""Changes to the folder of a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def change_summary(folder: Path, **values: Any) -> None:
    path = folder / "summary.json"
    summary = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({**summary, **values}), encoding="utf-8")
