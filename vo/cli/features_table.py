"""Results of `vo features` as tables and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from vo.cli.console import print_table, standard_output
from vo.tools.laboratory.comparison import Comparison
from vo.tools.laboratory.examination import FeatureReport
from vo.tools.laboratory.repeatability import ACCURACIES_PX, PlaneScore


@dataclass(frozen=True)
class FeaturesResult:
    """What was measured; one of the three lists has an entry for each method."""

    target: str
    size: tuple[int, int]
    frame: int | None
    reports: tuple[FeatureReport, ...] = ()
    planes: tuple[PlaneScore, ...] = ()
    rows: tuple[Comparison, ...] = ()
    picture: Path | None = None

    def to_dict(self) -> dict[str, Any]:
        """For JSON; numbers that are not known are null."""
        methods = [
            *map(asdict, self.reports),
            *(score._asdict() for score in self.planes),
            *map(asdict, self.rows),
        ]
        return {
            "target": self.target,
            "width": self.size[0],
            "height": self.size[1],
            "frame": self.frame,
            "results": [{key: _known(value) for key, value in row.items()} for row in methods],
            "picture": None if self.picture is None else str(self.picture),
        }

    def show(self) -> None:
        """Print a table on standard output."""
        console = standard_output()
        frame = "" if self.frame is None else f", frame {self.frame}"
        console.print(
            escape(f"{self.target}{frame}: {self.size[0]} x {self.size[1]} pixels"), soft_wrap=True
        )
        if self.reports:
            print_table(console, _of_image(self.reports))
        elif self.planes:
            print_table(console, _of_plane(self.planes))
        else:
            print_table(console, _of_frames(self.rows))
        if self.picture is not None:
            console.print("picture:", escape(str(self.picture)), soft_wrap=True)


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _table(*names: str) -> Table:
    table = Table(box=None)
    table.add_column(names[0])
    for name in names[1:]:
        table.add_column(name, justify="right")
    return table


def _of_image(reports: Sequence[FeatureReport]) -> Table:
    table = _table("method", "features", "by octave", "spread", "response", "descriptor", "ms")
    for report in reports:
        low_high = "–" if report.response is None else "{:.3g} to {:.3g}".format(*report.response)
        table.add_row(
            escape(report.method),
            str(report.count),
            " ".join(map(str, report.by_octave)) or "–",
            f"{report.spread:.2f}",
            low_high,
            report.descriptor or "–",
            f"{report.ms:.1f}",
        )
    return table


def _of_plane(scores: Sequence[PlaneScore]) -> Table:
    table = _table(
        *("method", "features", "matches", "repeatability", "matching score", "precision"),
        *("corner px", *(f"≤{limit:g} px" for limit in ACCURACIES_PX)),
        *("ms per image", "ms to match"),
    )
    for score in scores:
        table.add_row(
            escape(score.method),
            f"{score.features[0]}, {score.features[1]}",
            str(score.matches),
            *(f"{v:.2f}" for v in (score.repeatability, score.matching_score, score.precision)),
            f"{score.corner_px:.2f}" if math.isfinite(score.corner_px) else "–",
            *(f"{v:.2f}" for v in (score.within_1_px, score.within_3_px, score.within_5_px)),
            f"{score.extract_ms:.1f}",
            f"{score.match_ms:.1f}",
        )
    return table


def _of_frames(rows: Sequence[Comparison]) -> Table:
    has_depth = any(math.isfinite(row.repeatability) for row in rows)
    table = _table(
        *("method", "gap", "pairs", "features", *(["repeatability"] if has_depth else [])),
        *("matching score", "precision", "inliers", "below 2°", "rotation °", "direction °"),
        *("ms per image", "ms to match"),
    )
    for row in rows:
        table.add_row(
            escape(row.method),
            str(row.gap),
            str(row.pairs),
            f"{row.features:.0f}",
            *([_number(row.repeatability)] if has_depth else []),
            *(_number(v) for v in (row.matching_score, row.precision, row.inlier_ratio)),
            _number(row.good_ratio),
            _number(row.rotation_deg),
            _number(row.direction_deg),
            f"{row.extract_ms:.1f}",
            f"{row.match_ms:.1f}",
        )
    return table


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"
