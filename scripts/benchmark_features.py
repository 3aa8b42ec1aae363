"""Detectors, descriptors and matchers on pairs of frames of known motion, for the docs."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.config import load_config
from vo.engine.features.descriptors import available_descriptors
from vo.engine.features.detectors import available_detectors
from vo.recordings.sources.registry import open_source
from vo.tools.laboratory.comparison import Comparison, compare, plan_pairs
from vo.tools.laboratory.methods import Method, fetched_methods, make_method
from vo.tools.laboratory.pictures import save_comparison

GAPS = (1, 5, 15, 30)
COUNT = 1024
CLIPS = ("rendered_hall_stereo", "kitti06_stereo_000-050", "kitti07_mono_000-099")
SUITE = ("04_corridor_handheld", "09_terrain_drone")
BASE = "orb"  # times are given as ratios to it

_DESCRIBED = ("fast", "shi_tomasi", "sift", "akaze", "brisk")  # with every descriptor for all
_DESCRIPTORS = ("rbrief", "brief", "rootsift", "brisk", "freak", "latch")
_OF_THEMSELVES = {"fast": "rbrief", "shi_tomasi": "rbrief", "sift": "rootsift", "brisk": "brisk"}
_VARIANTS = {
    "one direction": ["matching.cross_check=false"],
    "ratio 0.7": ["matching.ratio=0.7"],
    "no ratio test": ["matching.ratio=1"],
}
_VARIED = ("orb", "sift")


def measure_features(options: argparse.Namespace, say: Callable[[str], None]) -> dict[str, Any]:
    """Rows of every method for every recording that exists."""
    methods = [m for m in benchmark_methods() if options.only in m.name]
    say(f"{len(methods)} methods")
    rows: list[dict[str, Any]] = []
    for name, folder in _recordings(options):
        recording = open_source(folder, mode="mono")
        pairs = plan_pairs(recording, GAPS, options.runs)
        say(f"{name}: {len(pairs)} pairs")
        found = compare(methods, pairs, recording.rig.cam0)
        rows += [{"recording": name, **asdict(row)} for row in found]
    return {"count": COUNT, "runs": options.runs, "results": rows}


def benchmark_methods() -> list[Method]:
    """Detectors with their own and with other descriptors, matchers, and optical flow."""
    detectors, descriptors = available_detectors(), available_descriptors()
    names = ["orb", *detectors]
    names += [
        f"{detector}+{descriptor}"
        for detector in _DESCRIBED
        for descriptor in _DESCRIPTORS
        if detector in detectors
        and descriptor in descriptors
        and descriptor != _OF_THEMSELVES.get(detector)
    ]
    names += [f"{name}/{matcher}" for name in _VARIED for matcher in ("flann", "ann")]
    names += [name if "/" in name else f"{name}/mnn" for name in fetched_methods()]
    names += ["fast/klt", "shi_tomasi/klt"]
    plain = _config()
    methods = [make_method(name, plain.features, plain.matching) for name in names]
    for name in _VARIED:
        for words, settings in _VARIANTS.items():
            config = _config(*settings)
            method = make_method(name, config.features, config.matching)
            method.name = f"{name}, {words}"  # type: ignore[misc]
            methods.append(method)
    return methods


def _config(*settings: str) -> Any:
    return load_config("default", [f"features.count={COUNT}", *settings])


def _recordings(options: argparse.Namespace) -> list[tuple[str, Path]]:
    """Names and folders of the recordings that exist."""
    from data_synth.cache import cached_sequence
    from data_synth.recipe import load_recipe, recipe_folder

    found = [(name, options.data / name) for name in CLIPS if (options.data / name).is_dir()]
    for name in SUITE:
        recipe = load_recipe(recipe_folder() / "suite" / f"{name}.yaml")
        found.append((name, cached_sequence(recipe, options.cache, name)))
    return found


def features_document(report: dict[str, Any]) -> str:
    """The section of the page: methods by the ratio of good pairs, best first."""
    rows = report["results"]
    by_method = {row["method"]: [r for r in rows if r["method"] == row["method"]] for row in rows}
    base_ms = _pair_ms(by_method[BASE]) if BASE in by_method else 0.0
    lines = [
        "| method | features | inlier ratio | "
        + " | ".join(f"< 2°, gap {gap}" for gap in GAPS)
        + " | rotation, ° | direction, ° | time / ORB's |",
        "| --- " + "| ---: " * (5 + len(GAPS)) + "|",
    ]
    for method, own in sorted(by_method.items(), key=lambda item: -_good(item[1])):
        good = [_good([row for row in own if row["gap"] == gap]) for gap in GAPS]
        cells = [
            _code(method),
            f"{_mean(own, 'features'):.0f}",
            f"{_mean(own, 'inlier_ratio'):.2f}",
            *(f"{ratio:.2f}" for ratio in good),
            f"{_median_of(own, 'rotation_deg'):.2f}",
            f"{_median_of(own, 'direction_deg'):.1f}",
            f"{_pair_ms(own) / base_ms:.2g}" if base_ms else "–",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    recordings = list(dict.fromkeys(row["recording"] for row in rows))
    pairs = sum(row["pairs"] for row in by_method[next(iter(by_method))])
    times = (
        f"ORB takes {base_ms:.0f} ms of CPU time for a pair of images, features and matches, in "
        "one thread; other times are ratios to it, as all methods see a pair one after the other. "
        if base_ms
        else ""
    )
    words = (
        f"Made by `scripts/benchmark --features --runs {report['runs']} --write`: "
        f"{pairs} pairs of {len(recordings)} recordings ({', '.join(recordings)}), "
        f"{report['count']} features at most. {times}Methods are in order of the ratio of all "
        f"pairs with errors below 2°. {report['date']}, {report['machine']}, {report['versions']}."
    )
    plot = "![Pairs with errors below 2° by method and gap, and CPU times](../images/features.png)"
    return "\n".join([*wrapped(words), "", plot, "", *lines])


def _code(method: str) -> str:
    name, comma, words = method.partition(",")
    return f"`{name}`{comma}{words}"


def wrapped(text: str) -> list[str]:
    """Lines of at most 100 characters."""
    import textwrap

    return textwrap.wrap(text, 100, break_long_words=False, break_on_hyphens=False)


def pooled(rows: Sequence[dict[str, Any]]) -> list[Comparison]:
    """Rows of each method and gap over all recordings."""
    keys = dict.fromkeys((row["method"], row["gap"]) for row in rows)
    result = []
    for method, gap in keys:
        own = [row for row in rows if (row["method"], row["gap"]) == (method, gap)]
        first = Comparison(**{k: v for k, v in own[0].items() if k != "recording"})
        result.append(
            replace(
                first,
                pairs=sum(row["pairs"] for row in own),
                good_ratio=_good(own),
                extract_ms=_mean(own, "extract_ms"),
                match_ms=_mean(own, "match_ms"),
            )
        )
    return result


def plot_features(path: Path, report: dict[str, Any]) -> None:
    """The plot of the page: methods by the ratio of good pairs, best first."""
    rows = report["results"]
    order = dict.fromkeys(row["method"] for row in rows)
    best = sorted(order, key=lambda m: -_good([row for row in rows if row["method"] == m]))
    merged = sorted(pooled(rows), key=lambda row: best.index(row.method))
    save_comparison(path, merged, f"{report['count']} features, all recordings")


def _mean(rows: Sequence[dict[str, Any]], name: str) -> float:
    """Mean over pairs."""
    if not rows:
        return float("nan")
    return float(np.average([row[name] for row in rows], weights=[row["pairs"] for row in rows]))


def _good(rows: Sequence[dict[str, Any]]) -> float:
    return _mean(rows, "good_ratio")


def _median_of(rows: Sequence[dict[str, Any]], name: str) -> float:
    """Median of the medians over recordings and gaps."""
    return float(np.nanmedian([row[name] for row in rows]))


def _pair_ms(rows: Sequence[dict[str, Any]]) -> float:
    return 2.0 * _mean(rows, "extract_ms") + _mean(rows, "match_ms")
