"""Sections of docs/experiments/benchmark-tables.md as Markdown."""

from __future__ import annotations

import textwrap
from typing import Any

from benchmark_cases import HARD_ATE_M, HARD_ATE_RATIO, Case, judge

Result = dict[str, Any]

WIDTH = 100
PEERS_NOTE = """\
Other systems were measured on the same files on another day, with evo 1.38.1; medians of 3 runs.
ORB-SLAM3 is V1.0 with 2000 features and loop closing off. It was allowed to finish mapping after
every frame, which improves its result. libviso2 has its defaults, pycolmap 4.2.1 uses all frames at
once, "tutorial" is a well-known Python odometry from frame to frame that takes its mono scale from
the truth. The stereo result of ORB-SLAM3 varies from run to run (kitti06: 0.044 to 0.054 m). On a
machine of two cores with no other load, ORB-SLAM3 tracks a kitti06 stereo frame in 25-30 ms and
libviso2 in 20 ms, where the limit is 13.7 ms; compare such times only as ratios to the limit."""
ACCURACY_NOTE = """\
ATE and RPE are root mean squares against the ground truth, after alignment by SE(3) in stereo and
Sim(3) in mono; RPE and rotation are over one frame. *Smoothed* poses also use the frames shortly
after them, *causal* ones are available at run time. Of several segments, the longest is evaluated.
A dash: does not apply, or not known."""
SPEED_NOTE = """\
*Limit* is the unavoidable part: decoding the PNGs and extracting 2000 ORB features from each with
OpenCV in two threads, measured within minutes of the run. *Wall* is the time of the whole command
per frame, including start-up; *tracking* excludes start-up and end."""


def document(report: Result, cases: dict[str, Case]) -> str:
    """The section on real recordings."""
    results = report["results"]
    return "\n".join([
        *made_by(f"--runs {report['runs']} --write", run_conditions(report)),
        "",
        "### Accuracy",
        "",
        *paragraph(ACCURACY_NOTE),
        "",
        *_accuracy(results, cases),
        "",
        *paragraph(PEERS_NOTE),
        "",
        "### Speed",
        "",
        *paragraph(SPEED_NOTE),
        "",
        *_speed(results),
        "",
        "Milliseconds per stage, median (95th percentile) over the frames in which it ran:",
        "",
        *_stages(results),
        "",
        "Start-up, `vo run` on 2 frames with everything compiled before: "
        f"{report['start_up_s']:.1f} s.",
    ])  # fmt: skip


def suite_document(report: Result, cases: dict[str, Case]) -> str:
    """The section on the synthetic suite."""
    results = report["results"]
    judged = [reached for r in results for _, reached in judge(cases[r["name"]], r)]
    note = (
        "t_rel is the mean drift over sub-paths of 5 to 50 m, or of 100 m and more where the path "
        "is long enough. ATE in percent and t_rel are of the smoothed trajectory, aligned as "
        "above; wall and limit are as above. On hard sequences a loss is correct, but a path "
        f"more than {HARD_ATE_M:g} m and {100 * HARD_ATE_RATIO:g} % of its length from the truth "
        f"is a failure. {sum(judged)} of {len(judged)} targets are reached "
        "(`scripts/benchmark_cases.py`)."
    )
    made = f"--synth --runs {report['runs']} --write"
    return "\n".join([
        *made_by(made, run_conditions(report), " from the recipes in `configs/synth/suite`"),
        "",
        *paragraph(note),
        "",
        *_suite_rows(results),
    ])  # fmt: skip


def hard_document(report: Result, cases: dict[str, Case]) -> str:
    """The section on the hard set, with and without inertial sensors."""
    kinds: dict[str, list[bool]] = {}
    for result in report["results"]:
        case = cases[result["name"]]
        judged = [reached for _, reached in judge(case, result)]
        if case.imu:
            kinds.setdefault(case.mode, []).append(all(judged))
    reached = {mode: f"{sum(found)} of {len(found)}" for mode, found in kinds.items()}
    note = (
        "Poses by the sensor alone count as poses. Goals: with two cameras and the sensor all "
        "frames in one segment, with an ATE of at most 0.2 % of the path "
        f"({reached.get('stereo', '–')}); with one camera and the sensor all frames after the "
        f"start in one segment, with a scale within 1 % ({reached.get('mono', '–')})."
    )
    head = ["sequence", "mode", "path, m", "frames with a pose", "segments", "ATE smoothed, m",
            "ATE, % of path", "scale error, %"]  # fmt: skip
    rows = []
    for r in report["results"]:
        case = cases[r["name"]]
        cells = _suite_cells(r) if r.get("failed") else [
            number(r["path_m"], 1), f"{r['posed']}/{r['frames']}", str(r["segments"]),
            number(r["ate_m"], 4), number(r["ate_percent"], 2), number(r["scale_percent"], 2, "+"),
        ]  # fmt: skip
        rows.append([case.folder, r["name"].removeprefix(case.folder).strip(), *cells[:6]])
    made = made_by(
        f"--hard --runs {report['runs']} --write",
        f"{_machine(report)}; preset `{report['config']}`.",
        " from the recipes in `configs/synth/hard`",
    )
    return "\n".join([*made, "", *paragraph(note), "", *table(head, rows)])


def generator_document(report: Result) -> str:
    """The section on the speed of the generator of synthetic recordings."""
    head = ["world", "sequence", "build, s", "stereo frames/s", "peak MB"]
    rows = [
        [r["world"], r["motion"], number(r["build_s"], 1), number(r["fps"], 1),
         number(r["peak_mb"], 0)]
        for r in report["results"]
    ]  # fmt: skip
    conditions = (
        f"{_machine(report)}. Stereo at 752 x 480 with motion blur, noise, auto-exposure and PNG "
        "files written, after everything was compiled."
    )
    return "\n".join([*made_by("--generator --write", conditions), "", *table(head, rows)])


def reading_document(report: Result) -> str:
    """The section on the speed of reading, and on the cost of an .rrd."""
    head = ["recording", "stereo frames/s", "CPU, ms/frame", "MB for 100 frames"]
    rows = [
        [r["name"], number(r["fps"], 0), number(r["cpu_ms"], 1), number(r["mb"], 0)]
        for r in report["reading"]
    ]
    conditions = (
        f"{_machine(report)}. Medians of 5. Reading alone, 752 x 480, 100 stereo frames with "
        "noise, from the disk cache:"
    )
    cost_head = ["sequence", "recording", "wall, ms/frame", "cost, %", "kB/frame"]
    return "\n".join([
        *made_by("--reading --write", conditions),
        "",
        *table(head, rows),
        "",
        "`vo run` with and without `--rrd`; wall time of the run without start-up:",
        "",
        *table(cost_head, _recording_rows(report["recording"])),
    ])  # fmt: skip


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Lines of a Markdown table, numbers aligned right."""
    rule = ["---" if text in _TEXTS else "---:" for text in head]
    return ["| " + " | ".join(cells) + " |" for cells in (head, rule, *rows)]


def number(value: float | None, digits: int, sign: str = "") -> str:
    """A number as text, a dash for None."""
    return "–" if value is None else f"{value:{sign}.{digits}f}"


_TEXTS = ("sequence", "mode", "system", "world", "recording")


def paragraph(text: str) -> list[str]:
    """Lines of a paragraph."""
    return textwrap.wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False)


def made_by(arguments: str, conditions: str, source: str = "") -> list[str]:
    """The paragraph with the command that makes a section, and the conditions of its last run."""
    return paragraph(f"Made by `scripts/benchmark {arguments}`{source}. {conditions}")


def _machine(report: Result) -> str:
    return f"{report['date']}, {report['machine']}; {report['versions']}"


def run_conditions(report: Result) -> str:
    """When, where and how `vo run` was measured."""
    runs = report["runs"]
    chosen = "one run each" if runs == 1 else f"the run of median wall time of {runs}"
    setting = f"preset `{report['config']}`" + "".join(f", `{s}`" for s in report["set"])
    return (
        f"{_machine(report)}; {setting}; {chosen}. "
        "Every figure is of the whole command `vo run`, started as a user starts it, without "
        "inertial sensors (`--no-imu`)."
    )


def _accuracy(results: list[Result], cases: dict[str, Case]) -> list[str]:
    head = ["sequence", "mode", "system", "frames with a pose", "segments", "ATE smoothed, m",
            "ATE causal, m", "RPE, m", "rotation, °", "scale error, %"]  # fmt: skip
    rows = []
    for result in results:
        case = cases[result["name"]]
        rows.append([case.folder, case.mode, "**vo**", *_accuracy_cells(result)])
        rows += [
            ["", "", p.system, p.frames, "",
             *(_given(x) for x in (p.ate, p.ate_causal, p.rpe)), "", ""]
            for p in case.peers
        ]  # fmt: skip
    return table(head, rows)


def _accuracy_cells(result: Result) -> list[str]:
    if result.get("failed"):
        return ["failed: " + result["failed"], *[""] * 6]
    return [
        f"{result['posed']}/{result['frames']}", str(result["segments"]),
        *(number(result[key], 4) for key in ("ate_m", "ate_causal_m", "rpe_m")),
        number(result["rotation_deg"], 3), number(result["scale_percent"], 2, "+"),
    ]  # fmt: skip


def _suite_rows(results: list[Result]) -> list[str]:
    head = ["sequence", "mode", "path, m", "frames with a pose", "segments", "ATE smoothed, m",
            "ATE causal, m", "ATE, % of path", "t_rel, %", "scale error, %", "frames/s",
            "wall : limit"]  # fmt: skip
    return table(head, [[r["folder"], r["mode"], *_suite_cells(r)] for r in results])


def _suite_cells(r: Result) -> list[str]:
    if r.get("failed"):
        return ["failed: " + r["failed"], *[""] * 9]
    return [
        number(r["path_m"], 1),
        f"{r['posed']}/{r['frames']} ({100 * r['posed'] / r['frames']:.0f} %)",
        str(r["segments"]), number(r["ate_m"], 4), number(r["ate_causal_m"], 4),
        number(r["ate_percent"], 2), number(r["t_rel_percent"], 2),
        number(r["scale_percent"], 2, "+"), number(1e3 / r["wall_ms"], 1),
        number(r["wall_ms"] / r["limit_ms"], 2),
    ]  # fmt: skip


def _speed(results: list[Result]) -> list[str]:
    head = ["sequence", "mode", "frames/s, command", "frames/s, tracking", "wall, ms/frame",
            "limit, ms/frame", "wall : limit", "keyframes", "peak MB"]  # fmt: skip
    rows = [
        [
            r["folder"], r["mode"], number(1e3 / r["wall_ms"], 1), number(r["tracking_fps"], 1),
            number(r["wall_ms"], 1), number(r["limit_ms"], 1),
            number(r["wall_ms"] / r["limit_ms"], 2), str(r["keyframes"]),
            number(r["peak_rss_mb"], 0),
        ]
        for r in _finished(results)
    ]  # fmt: skip
    return table(head, rows)


def _stages(results: list[Result]) -> list[str]:
    done = _finished(results)
    names = list(dict.fromkeys(name for r in done for name in r["stages"]))
    rows = [
        [r["folder"], r["mode"], *(_times(r["stages"].get(name)) for name in names)] for r in done
    ]
    return table(["sequence", "mode", *names], rows)


def _recording_rows(runs: list[Result]) -> list[list[str]]:
    """Rows of the cost of an .rrd, relative to the run without one on the same sequence."""
    plain = {r["sequence"]: r["wall_ms"] for r in runs if not r["kb"]}
    return [
        [r["sequence"], r["name"], number(r["wall_ms"], 1),
         number(100.0 * (r["wall_ms"] / plain[r["sequence"]] - 1.0), 0) if r["kb"] else "–",
         number(r["kb"], 0) if r["kb"] else "–"]
        for r in runs
    ]  # fmt: skip


def _times(stage: dict[str, float] | None) -> str:
    return "–" if stage is None else f"{stage['median_ms']:.1f} ({stage['p95_ms']:.0f})"


def _finished(results: list[Result]) -> list[Result]:
    return [result for result in results if not result.get("failed")]


def _given(value: float | None) -> str:
    """A number with the digits it was given with."""
    return "–" if value is None else f"{value:g}"
