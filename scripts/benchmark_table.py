"""What the benchmark runs on, what others reach there, and the document that shows both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

PEERS_NOTE = """\
Peers were measured on the same files, another day, with evo 1.38.1; medians of 3 runs. ORB-SLAM3
is V1.0 with 2000 features and loop closing off; it was allowed to finish mapping after every frame,
which flatters it. libviso2 has its defaults, pycolmap 4.2.1 sees all frames at once, "tutorial" is
a well-known Python odometry from frame to frame that takes its mono scale from the truth.
ORB-SLAM3's stereo result differs from run to run (kitti06: 0.044 to 0.054 m). On a machine of two
cores with nothing else running, ORB-SLAM3 tracks a kitti06 stereo frame in 25-30 ms and libviso2 in
20 ms, where the limit is 13.7 ms; compare such times as ratios to the limit only."""


@dataclass(frozen=True)
class Peer:
    """What another system reaches: frames with a pose, ATE in metres, RPE in metres per frame."""

    system: str
    frames: str
    ate: float | None = None
    ate_causal: float | None = None
    rpe: float | None = None


@dataclass(frozen=True)
class Case:
    """A sequence in one mode, the goals there, and what others reach.

    Attributes:
        folder: of the sequence inside the data folder.
        mode: `mono` or `stereo`.
        images: patterns of the images of each camera.
        ate: goal in metres.
        scale: goal for the error of scale in percent.
        frames: goal for the frames with a pose; by default all from the start-up on.
        hard: there is too little to see, so that being lost is right and only a wrong path fails.
        ate_percent: goal for the ATE in percent of the path.
        t_rel: goal for the drift in percent.
        peers: what others reach.
    """

    folder: str
    mode: str
    images: tuple[str, ...]
    ate: float | None = None
    scale: float | None = None
    frames: int | None = None
    hard: bool = False
    ate_percent: float | None = None
    t_rel: float | None = None
    peers: tuple[Peer, ...] = ()

    @property
    def name(self) -> str:
        """Sequence and mode in one."""
        return f"{self.folder} {self.mode}"


# A hard sequence may be lost, but poses that are claimed must be about right.
HONEST_M, HONEST_SHARE = 0.1, 0.02

_KITTI = ("image_0/*.png", "image_1/*.png")
_RAW = ("cam0/data/*.png", "cam1/data/*.png")
_MAV = ("mav0/cam0/data/*.png", "mav0/cam1/data/*.png")
_06, _07, _HALL = "kitti06_stereo_000-050", "kitti07_mono_000-099", "rendered_hall_stereo"

CASES = (
    Case(_06, "stereo", _KITTI, ate=0.10, scale=2.0, peers=(
        Peer("ORB-SLAM3", "51/51", 0.051, None, 0.011),
        Peer("libviso2", "51/51", None, 0.120, 0.014),
        Peer("tutorial", "51/51", None, 0.419, 0.044),
    )),
    Case(_06, "mono", _KITTI[:1], ate=0.08, peers=(
        Peer("ORB-SLAM3", "50/51", 0.023, 0.066, 0.010),
        Peer("pycolmap", "51/51", 0.026, None, 0.008),
        Peer("libviso2", "51/51", None, 0.236, 0.060),
        Peer("tutorial", "51/51", None, 0.350, 0.236),
    )),
    Case(_07, "mono", _KITTI[:1], ate=0.35, frames=90, peers=(
        Peer("ORB-SLAM3", "96/100", 0.277, 0.288, 0.023),
    )),
    Case("kitti_raw_stereo_000-099", "stereo", _RAW, ate=0.25, scale=1.0, peers=(
        Peer("ORB-SLAM3", "98/98", 0.495, None, 0.101),
        Peer("libviso2", "98/98", None, 0.159, 0.024),
    )),
    Case(_HALL, "stereo", _MAV, ate=0.03, peers=(
        Peer("ORB-SLAM3", "200/200", 0.0051, 0.0065, 0.0032),
        Peer("libviso2", "200/200", None, 0.030, 0.0048),
    )),
    Case(_HALL, "mono", _MAV[:1], ate=0.10),
    Case("tum_fr3_cabinet_58_lowtexture", "mono", ("rgb/*.*",), hard=True),
)  # fmt: skip


def suite_cases(folders: list[str]) -> tuple[Case, ...]:
    """The synthetic suite in stereo and mono; those named `hard` are hard on purpose."""
    cases = []
    for folder in folders:
        if "_hard_" in folder:
            cases += [Case(folder, "stereo", _MAV, hard=True)]
            cases += [Case(folder, "mono", _MAV[:1], hard=True)]
        else:
            cases += [Case(folder, "stereo", _MAV, ate_percent=0.3, t_rel=0.3)]
            cases += [Case(folder, "mono", _MAV[:1], ate_percent=0.5)]
    return tuple(cases)


def judge(case: Case, result: dict[str, Any]) -> list[tuple[str, bool]]:
    """Each goal of a case with whether it is reached."""
    if result.get("failed"):
        return [("runs to its end", False)]
    goals = [("same bits", result["same_bits"])] if result["same_bits"] is not None else []
    posed, frames, ate = result["posed"], result["frames"], result["ate_m"]
    if case.hard:
        allowed_m = max(HONEST_M, HONEST_SHARE * (result["path_m"] or 0.0))
        wild = ate is not None and ate > allowed_m
        return [*goals, ("no wild path", not wild)]
    least = frames - result["starting"] if case.frames is None else case.frames
    goals += [(f"frames ≥ {least}", posed >= least), ("one segment", result["segments"] == 1)]
    if case.ate is not None:
        goals.append((f"ATE ≤ {case.ate:.2f}", ate is not None and ate <= case.ate))
    for key, goal, name in (
        ("ate_percent", case.ate_percent, "ATE"),
        ("t_rel_percent", case.t_rel, "t_rel"),
    ):
        if goal is not None:
            found = result[key]
            goals.append((f"{name} ≤ {goal:g} %", found is not None and found <= goal))
    if case.scale is not None:
        error = result["scale_percent"]
        within = error is not None and abs(error) <= case.scale
        goals.append((f"scale within {case.scale:g} %", within))
    return goals


def document(report: dict[str, Any], cases: dict[str, Case]) -> str:
    """The section on real recordings as Markdown."""
    results = report["results"]
    return "\n".join([
        f"Made by `scripts/benchmark --runs {report['runs']} --write`, which makes it again. "
        f"{_circumstances(report)}",
        "",
        "### Accuracy",
        "",
        "ATE and RPE are root mean squares against the ground truth, after alignment by SE(3) in "
        "stereo and Sim(3) in mono; RPE and rotation are over one frame. *Smoothed* poses know "
        "what came shortly after them, *causal* ones are those that a robot would have had. "
        "Where the path broke, the longest segment is judged. A dash: does not apply, or not "
        "known.",
        "",
        *_accuracy(results, cases),
        "",
        PEERS_NOTE,
        "",
        "### Speed",
        "",
        "*The limit* is what cannot be avoided: decoding the PNGs and extracting 2000 ORB features "
        "from each with OpenCV, two threads, nothing else, measured in the same minutes. *Wall* "
        "is the time of the whole command by frame, start-up included; *tracking* leaves out "
        "the start-up and the end.",
        "",
        *_speed(results),
        "",
        "Milliseconds by stage, median (95th percentile) over the frames in which it ran:",
        "",
        *_stages(results),
        "",
        f"Start-up, `vo run` on 2 frames with everything compiled before: "
        f"{report['start_up_s']:.1f} s.",
    ])  # fmt: skip


def suite_document(report: dict[str, Any], cases: dict[str, Case]) -> str:
    """The section on the synthetic suite as Markdown."""
    results = report["results"]
    judged = [ok for r in results for _, ok in judge(cases[r["name"]], r)]
    return "\n".join([
        f"Made by `scripts/benchmark --synth --runs {report['runs']} --write` from the recipes in "
        f"`configs/synth/suite`. {_circumstances(report)}",
        "",
        "ATE by path and t_rel (mean drift over sub-paths of 5 to 50 m, or 100 m and more where "
        "the path is long enough) are of the smoothed trajectory, after alignment by SE(3) in "
        "stereo and Sim(3) in mono. What is hard on purpose may be lost, but may not claim a wrong "
        f"path: more than {HONEST_M:g} m and {100 * HONEST_SHARE:g} % of the path from the truth. "
        "Wall and limit as above. "
        f"{sum(judged)} of {len(judged)} goals are reached.",
        "",
        *_suite_rows(results, cases),
    ])  # fmt: skip


def _suite_rows(results: list[dict[str, Any]], cases: dict[str, Case]) -> list[str]:
    head = ["sequence", "mode", "path, m", "frames with a pose", "segments", "ATE smoothed, m",
            "ATE causal, m", "ATE, % of path", "t_rel, %", "scale error, %", "frames/s",
            "wall : limit", "goals"]  # fmt: skip
    rows = []
    for r in results:
        goals = "; ".join(("✓ " if ok else "✗ ") + text for text, ok in judge(cases[r["name"]], r))
        if r.get("failed"):
            rows.append([r["folder"], r["mode"], "failed: " + r["failed"], *[""] * 9, goals])
            continue
        share = f"{r['posed']}/{r['frames']} ({100 * r['posed'] / r['frames']:.0f} %)"
        rows.append([
            r["folder"], r["mode"], number(r["path_m"], 1), share, str(r["segments"]),
            number(r["ate_m"], 4), number(r["ate_causal_m"], 4), number(r["ate_percent"], 2),
            number(r["t_rel_percent"], 2), number(r["scale_percent"], 2, "+"),
            number(1e3 / r["wall_ms"], 1), number(r["wall_ms"] / r["limit_ms"], 2), goals,
        ])  # fmt: skip
    return table(head, rows)


def generator_document(report: dict[str, Any]) -> str:
    """The section on how fast recordings are made, as Markdown."""
    head = ["world", "sequence", "building, s", "stereo frames/s", "peak MB"]
    rows = [
        [r["world"], r["motion"], number(r["build_s"], 1), number(r["fps"], 1),
         number(r["peak_mb"], 0)]
        for r in report["results"]
    ]  # fmt: skip
    return "\n".join([
        f"Made by `scripts/benchmark --generator --write`. {report['date']}, {report['machine']}; "
        f"{report['versions']}. Stereo at 752 x 480 with motion blur, noise, auto-exposure and "
        "PNG files written, after everything was compiled.",
        "",
        *table(head, rows),
    ])  # fmt: skip


def reading_document(report: dict[str, Any]) -> str:
    """The section on reading, and on what an .rrd costs, as Markdown."""
    head = ["recording", "stereo frames/s", "CPU, ms/frame", "MB for 100 frames"]
    rows = [
        [r["name"], number(r["fps"], 0), number(r["cpu_ms"], 1), number(r["mb"], 0)]
        for r in report["reading"]
    ]
    plain = {r["sequence"]: r["wall_ms"] for r in report["recording"] if not r["kb"]}
    costs = [
        [r["sequence"], r["name"], number(r["wall_ms"], 1),
         number(100.0 * (r["wall_ms"] / plain[r["sequence"]] - 1.0), 0) if r["kb"] else "–",
         number(r["kb"], 0) if r["kb"] else "–"]
        for r in report["recording"]
    ]  # fmt: skip
    return "\n".join([
        f"Made by `scripts/benchmark --reading --write`. {report['date']}, {report['machine']}; "
        f"{report['versions']}. Medians of 5. Reading alone, 752 x 480, 100 stereo frames with "
        "noise, from the disk's cache:",
        "",
        *table(head, rows),
        "",
        "`vo run` with and without `--rrd`; wall time of the run without start-up:",
        "",
        *table(["sequence", "recording", "wall, ms/frame", "cost, %", "kB/frame"], costs),
    ])  # fmt: skip


def _circumstances(report: dict[str, Any]) -> str:
    chosen = f"of {report['runs']} runs each the one with the median wall time"
    chosen = "one run each" if report["runs"] == 1 else chosen
    setting = f"preset `{report['config']}`" + "".join(f", `{s}`" for s in report["set"])
    return (
        f"{report['date']}, {report['machine']}; {report['versions']}; {setting}; {chosen}. "
        "Every figure is of the whole command `vo run`, started as a user starts it."
    )


def _accuracy(results: list[dict[str, Any]], cases: dict[str, Case]) -> list[str]:
    head = ["sequence", "mode", "system", "frames with a pose", "segments", "ATE smoothed, m",
            "ATE causal, m", "RPE, m", "rotation, °", "scale error, %", "goals"]  # fmt: skip
    rows = []
    for result in results:
        case = cases[result["name"]]
        where = [case.folder, case.mode, "**vo**"]
        goals = "; ".join(("✓ " if ok else "✗ ") + text for text, ok in judge(case, result))
        if result.get("failed"):
            rows.append([*where, "failed: " + result["failed"], *[""] * 6, goals])
            continue
        rows.append([
            *where, f"{result['posed']}/{result['frames']}", str(result["segments"]),
            *(number(result[key], 4) for key in ("ate_m", "ate_causal_m", "rpe_m")),
            number(result["rotation_deg"], 3), number(result["scale_percent"], 2, "+"), goals,
        ])  # fmt: skip
        rows += [
            ["", "", p.system, p.frames, "",
             *(_given(x) for x in (p.ate, p.ate_causal, p.rpe)), "", "", ""]
            for p in case.peers
        ]  # fmt: skip
    return table(head, rows)


def _speed(results: list[dict[str, Any]]) -> list[str]:
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


def _stages(results: list[dict[str, Any]]) -> list[str]:
    """Milliseconds by stage, median (95th percentile), of the frames in which it ran."""
    done = _finished(results)
    names = list(dict.fromkeys(name for r in done for name in r["stages"]))
    rows = [
        [r["folder"], r["mode"], *(_times(r["stages"].get(name)) for name in names)] for r in done
    ]
    return table(["sequence", "mode", *names], rows)


def _times(stage: dict[str, float] | None) -> str:
    return "–" if stage is None else f"{stage['median_ms']:.1f} ({stage['p95_ms']:.0f})"


def _finished(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [result for result in results if not result.get("failed")]


_TEXTS = ("sequence", "mode", "system", "goals", "world")


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Lines of a Markdown table; numbers stand right."""
    rule = ["---" if text in _TEXTS else "---:" for text in head]
    return ["| " + " | ".join(cells) + " |" for cells in (head, rule, *rows)]


def _given(value: float | None) -> str:
    """A number with the digits that it was given with."""
    return "–" if value is None else f"{value:g}"


def number(value: float | None, digits: int, sign: str = "") -> str:
    """A number as text, a dash where there is none."""
    return "–" if value is None else f"{value:{sign}.{digits}f}"
