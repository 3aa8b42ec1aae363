"""Reads `.rrd` files back."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader

from vo.outputs.recorders import entities

STATIC = -1  # frame number of static rows


def read_rrd(path: Path, component: str) -> dict[str, list[tuple[int, Any]]]:
    """Rows (frame number, values) of a component by entity, in order of frames."""
    rows = defaultdict(list)
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if name.split(":")[-1] != component:
                continue
            has_frames = entities.FRAME_TIMELINE in batch.schema.names
            column = batch[entities.FRAME_TIMELINE].to_pylist() if has_frames else []
            frames = column or [STATIC] * len(batch)
            values = zip(frames, batch[name].to_pylist(), strict=True)
            rows[chunk.entity_path.lstrip("/")] += [row for row in values if row[1] is not None]
    return {entity: sorted(found, key=lambda row: row[0]) for entity, found in rows.items()}
