"""Rows of the table of robustness as text, JSON and Markdown."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from textwrap import fill
from typing import Any

from robustness_run import Outcome

_MAX_WARNING = 110


@dataclass(frozen=True)
class Row:
    """A recording with a fault, and the same one without."""

    situation: str
    variant: str
    clip: str
    outcome: Outcome
    clean: Outcome
    max_ate_m: float  # largest ATE that counts as right
    is_visible: bool = True  # whether the fault shows in the images

    @property
    def is_wrong(self) -> bool:
        """Whether the path is far from the truth."""
        return self.outcome.ate_m is not None and self.outcome.ate_m > self.max_ate_m

    @property
    def is_wrong_and_trusted(self) -> bool:
        """What must never happen."""
        return self.is_wrong and self.outcome.is_trusted and self.is_visible

    @property
    def step_ratio(self) -> float:
        """Longest step relative to the longest one of the clean recording."""
        longest = self.clean.longest_step_m
        return self.outcome.longest_step_m / longest if longest else 0.0

    @property
    def grade(self) -> str:
        """The row in a few words."""
        outcome = self.outcome
        if outcome.error:
            return outcome.verdict
        if outcome.ate_m is None:
            return "no path"
        if self.is_wrong:
            if not outcome.is_trusted:
                return "wrong, and says so"
            return "WRONG AND TRUSTED" if self.is_visible else "wrong, cannot be seen"
        return "right" if outcome.is_trusted else "right, but doubted"

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        ratios = {"step_ratio": self.step_ratio, "grade": self.grade}
        return {**asdict(self), **ratios, "wrong_and_trusted": self.is_wrong_and_trusted}


@dataclass(frozen=True)
class CleanRow:
    """A recording without faults."""

    name: str
    outcome: Outcome

    @property
    def false_alarms(self) -> int:
        """Number of kinds of faults that were reported."""
        return len(self.outcome.faults)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def line(row: Row) -> str:
    """A row for the terminal."""
    outcome = row.outcome
    return (
        f"{f'{row.situation}, {row.variant}, {row.clip}':58} {metres(outcome.ate_m):>8} "
        f"(clean {metres(row.clean.ate_m)})  {outcome.tracked:4.0%}  step x{row.step_ratio:<5.1f} "
        f"{row.grade:18} {' '.join(outcome.faults)} | {outcome.verdict} | {outcome.warning}"
    )


def clean_line(row: CleanRow) -> str:
    """A row of the clean section for the terminal."""
    outcome = row.outcome
    kinds = " ".join(outcome.faults) or "no faults"
    return f"{row.name:40} {metres(outcome.ate_m):>8}  {outcome.tracked:4.0%}  {kinds}"


def document(rows: list[Row], clean: list[CleanRow]) -> str:
    """Both tables and their counts, as Markdown."""
    grades: dict[str, int] = {}
    for row in rows:
        grades[row.grade] = grades.get(row.grade, 0) + 1
    counts = ", ".join(f"{count} {grade}" for grade, count in sorted(grades.items()))
    wrong = sum(row.is_wrong_and_trusted for row in rows)
    alarms = sum(row.false_alarms for row in clean)
    lines = [
        fill(f"{len(rows)} recordings with faults: {counts}. Wrong and trusted: **{wrong}**.", 100),
        "",
        "| situation | variant | recording | ATE, m | clean, m | frames | step | result "
        "| reported |",
        "| --- | --- | --- | ---: | ---: | ---: | ---: | --- | --- |",
    ]
    previous = ""
    for row in rows:
        outcome = row.outcome
        shown = row.situation if row.situation != previous else ""
        previous = row.situation
        reported = ", ".join(outcome.faults) or _short(outcome.warning)
        lines.append(
            f"| {shown} | {row.variant} | {row.clip} | {metres(outcome.ate_m)} "
            f"| {metres(row.clean.ate_m)} | {outcome.tracked:.0%} | {_step(row)} "
            f"| {row.grade} | {_cell(reported)} |"
        )
    if clean:
        lines += [
            "",
            f"{len(clean)} runs on recordings without faults. False alarms: **{alarms}**.",
            "",
            "| recording | ATE, m | frames | reported |",
            "| --- | ---: | ---: | --- |",
        ]
        for each in clean:
            kinds = ", ".join(each.outcome.faults) or "–"
            ate = metres(each.outcome.ate_m)
            lines.append(f"| {each.name} | {ate} | {each.outcome.tracked:.0%} | {kinds} |")
    return "\n".join(lines)


def metres(value: float | None) -> str:
    """A length with three significant digits."""
    return "–" if value is None else f"{value:.4f}" if value < 0.1 else f"{value:.3g}"


def _step(row: Row) -> str:
    return "–" if row.outcome.ate_m is None else f"{row.step_ratio:.1f}"


def _short(text: str) -> str:
    return text if len(text) <= _MAX_WARNING else text[: _MAX_WARNING - 1].rstrip() + "…"


def _cell(text: str) -> str:
    return text.replace("|", "/").replace("\n", " ")
