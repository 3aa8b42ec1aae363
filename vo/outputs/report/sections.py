"""Sections of a report, from top to bottom."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import cv2
import numpy as np

from vo.base.config import Config
from vo.base.files.bounded_files import read_text
from vo.base.files.bounded_json import load_json
from vo.base.files.bounded_yaml import load_yaml
from vo.base.types import Bytes, Ints
from vo.outputs.report.entry import Entry, Thumbnail
from vo.outputs.report.markup import Markup, element, inline_svg, join, number, table
from vo.outputs.report.plots.catalogue import Plot
from vo.outputs.report.plots.style import SERIES
from vo.outputs.report.run_folder import FrameTable
from vo.outputs.report.verdict import key_figures, verdict


def changed_settings(texts: Sequence[str], defaults: Config) -> dict[str, list[str]]:
    """Values of each run by `section.key`, for settings that differ from the default in any run.

    `texts`: `config.yaml` of each run; an invalid one has no values. `defaults`: the default
    settings.
    """
    default_values = dict(_flat(defaults.model_dump(mode="json")))
    found = [dict(_flat(_parsed(text))) for text in texts]
    names = [
        *default_values,
        *(name for each in found for name in each if name not in default_values),
    ]
    return {
        name: [str(each.get(name, "–")) for each in found]
        for name in dict.fromkeys(names)
        if any(name in each and each[name] != default_values.get(name) for each in found)
    }


def _parsed(text: str) -> dict[str, Any]:
    try:
        parsed = load_yaml(text)
    except ValueError:
        return {}
    return parsed if isinstance(parsed, dict) else {}


def _flat(values: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


_MAX_EVENTS = 8
_MAX_LOSSES = 3
_WIDTH_PX = 320


class Event(NamedTuple):
    """An event at a frame; `row` is the row of the frame in the table."""

    row: int
    name: str


def choose_events(frames: FrameTable) -> list[Event]:
    """The first pose, losses, recoveries and a uniform subset of keyframes, in time order."""
    tracked = frames.state == "tracking"
    if not tracked.any():
        return [Event(0, "first frame")] if len(frames) else []
    found = {int(np.argmax(tracked)): "first pose"}
    change = np.flatnonzero(np.diff(tracked.astype(np.int8))) + 1
    for row in _uniform_subset(change[~tracked[change]], _MAX_LOSSES):
        found.setdefault(row, "lost")
        later = np.flatnonzero(tracked[row:])
        if len(later):
            found.setdefault(row + int(later[0]), "recovered")
    keyframes = np.array([r for r in np.flatnonzero(frames.keyframe) if r not in found], np.int64)
    for row in _uniform_subset(keyframes, _MAX_EVENTS - len(found)):
        found[row] = "keyframe"
    return [Event(row, found[row]) for row in sorted(found)]


def _uniform_subset(rows: Ints, max_count: int) -> list[int]:
    if len(rows) <= max_count:
        return [int(row) for row in rows]
    return [
        int(rows[i]) for i in np.linspace(0, len(rows) - 1, max(max_count, 0)).round().astype(int)
    ]


def shrink(image: Bytes) -> Bytes:
    """An image (H, W) reduced to the width of a thumbnail."""
    height, width = image.shape
    if width <= _WIDTH_PX:
        return image
    size = (_WIDTH_PX, max(round(height * _WIDTH_PX / width), 1))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


_JPEG_QUALITY = 70
_SIGNS = {"good": "✓", "caution": "!", "bad": "✕"}


def run_header(entry: Entry, is_comparison: bool) -> Markup:
    """Verdict, warnings and, for a report of one run, its key figures."""
    found = verdict(entry)
    summary = entry.run.summary
    sign = element("span", _SIGNS[found.grade], class_="sign", aria_hidden="true")
    chip = element("span", sign, found.word, class_=f"chip {found.grade}")
    about = f"{summary['mode']}, {summary['format']}, from {summary['source']}"
    title = element("h2", _swatch(entry.number) if is_comparison else Markup(), entry.name, chip)
    parts = [title, element("p", *_sentences(found.sentences), class_="verdict")]
    if not is_comparison:
        parts.append(_cards(entry))
    warnings = [*summary["warnings"], *([summary["error"]] if summary["error"] else [])]
    if warnings:
        items = [element("li", text) for text in warnings]
        parts.append(element("ul", *items, class_="warnings", aria_label="warnings"))
    notes = [about, *([entry.truth_note] if entry.truth_note else []), *entry.notes]
    parts.append(element("p", *_lines(notes), class_="notes"))
    return element("section", *parts, class_="run")


def _sentences(sentences: Sequence[str]) -> list[str]:
    return [Markup(" ") if i % 2 else sentences[i // 2] for i in range(2 * len(sentences) - 1)]


def _lines(texts: Sequence[str]) -> list[str]:
    return [Markup("<br>") if i % 2 else texts[i // 2] for i in range(2 * len(texts) - 1)]


def _swatch(number: int) -> Markup:
    return element(
        "span", "", class_="swatch", style=f"background:var(--series-{number % len(SERIES)})"
    )


def _cards(entry: Entry) -> Markup:
    cards = [
        element(
            "div",
            element("dt", each.name),
            element("dd", each.value),
            element("dd", each.meaning, class_="meaning"),
        )
        for each in key_figures(entry)
    ]
    return element("dl", *cards, class_="cards")


def comparison(entries: Sequence[Entry]) -> Markup:
    """A table with a column for every run."""
    columns = [{each.name: each for each in key_figures(entry)} for entry in entries]
    names = list(dict.fromkeys(name for column in columns for name in column))
    rows = [
        ["verdict", *(verdict(entry).word for entry in entries)],
        ["cameras", *(str(entry.run.summary["mode"]) for entry in entries)],
    ]
    for name in names:
        found = [column.get(name) for column in columns]
        rows.append(
            [name, *("–" if each is None else _cell(each.value, each.meaning) for each in found)]
        )
    heading = ["", *(join(_swatch(entry.number), entry.name) for entry in entries)]
    return element("section", element("h2", "Compared"), table(heading, rows, class_="compared"))


def _cell(value: str, meaning: str) -> Markup:
    return join(value, element("small", meaning))


def plot_section(title: str, plots: Sequence[Plot]) -> Markup:
    """Figures under a heading; empty without figures."""
    return element("section", element("h2", title), figures(plots)) if plots else Markup()


def figures(plots: Sequence[Plot], class_: str = "plots") -> Markup:
    """Figures beside each other, or one below the other on a narrow screen."""
    found = []
    for plot in plots:
        picture = inline_svg(plot.figure, plot.name.replace("_", "-"), plot.caption)
        caption = element("figcaption", plot.caption)
        found.append(element("figure", picture, caption, id=f"plot-{plot.name}"))
    return element("div", *found, class_=class_)


def image_section(entry: Entry, title: str) -> Markup:
    """Images of frames with events."""
    if not entry.thumbnails:
        return Markup()
    thumbnails = [_thumbnail(each) for each in entry.thumbnails]
    return element("section", element("h2", title), element("div", *thumbnails, class_="thumbs"))


def _thumbnail(thumbnail: Thumbnail) -> Markup:
    caption = f"{thumbnail.event}: frame {thumbnail.frame}, {thumbnail.seconds:.1f} s"
    image = _embedded(thumbnail.image, caption)
    return element("figure", image, element("figcaption", caption))


def _embedded(picture: Bytes, caption: str) -> Markup:
    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    assert done
    source = "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")
    height, width = picture.shape[:2]
    return Markup(f'<img src="{source}" width="{width}" height="{height}" alt="{caption}">')


def dense_views(entry: Entry, title: str) -> Markup:
    """Pictures of the cloud that `vo dense` has made of the run, if it has, of these poses."""
    found: list[Markup] = []
    folder = entry.run.path / "dense"
    with suppress(OSError, ValueError, AttributeError):
        poses = hashlib.sha256((entry.run.path / "poses.csv").read_bytes()).hexdigest()
        if load_json(read_text(folder / "dense.json")).get("poses_sha256") != poses:
            return Markup()
    for name, caption in (("above", "from above"), ("turntable", "from four sides")):
        path = folder / f"{name}.png"
        picture = cv2.imread(str(path)) if path.is_file() else None
        if picture is not None:
            caption = f"Cloud of points, {caption}, and the path"
            image = _embedded(np.asarray(picture, np.uint8), caption)
            found.append(element("figure", image, element("figcaption", caption)))
    return element("section", element("h2", title), *found) if found else Markup()


def frames_without_pose(entry: Entry) -> Markup:
    """Frames without a pose, and the reasons."""
    rows = [
        [_range(each["first"], each["last"]), str(each["frames"]), each["state"], each["reason"]]
        for each in entry.run.summary["without_pose"]
    ]
    title = f"Frames without a pose, {entry.name} ({len(rows)} ranges)"
    return _folded(title, ["frames", "number", "state", "reason"], rows)


def _folded(title: str, heading: list[str], rows: list[list[str]]) -> Markup:
    """A table that opens by a click; empty without rows."""
    if not rows:
        return Markup()
    return element("details", element("summary", title), table(heading, rows))


def _range(first: int, last: int) -> str:
    return str(first) if first == last else f"{first} to {last}"


def segments(entry: Entry) -> Markup:
    """Segments of the path, if there are several."""
    found = entry.run.summary["segments"]
    if len(found) < 2:
        return Markup()
    rows = [
        [str(each["segment"]), _range(each["first_frame"], each["last_frame"])]
        + [str(each["frames"]), number(each["path_m"])]
        for each in found
    ]
    heading = ["segment", "frames", "with a pose", f"path ({entry.run.unit})"]
    return _folded(f"Segments, {entry.name}", heading, rows)


def loops(entry: Entry) -> Markup:
    """Places that were seen again, if there are any."""
    rows = [
        [str(each["frame"]), str(each["earlier_frame"]), _kind(each), str(each["inliers"])]
        + [_moved(each["correction_m"]), _moved(each["correction_deg"])]
        for each in entry.run.summary.get("loops", ())
    ]
    heading = ["frame", "seen before in", "kind", "inliers"]
    heading += [f"moved by ({entry.run.unit})", "turned by (deg)"]
    return _folded(f"Loops, {entry.name}", heading, rows)


def relocalisations(entry: Entry) -> Markup:
    """Segments whose place in an older world was found, if there are any."""
    rows = [
        [str(each["frame"]), str(each["segment"]), str(each["earlier_frame"]), str(each["loops"])]
        + [str(each["inliers"]), _moved(each["correction_m"]), _moved(each["correction_deg"])]
        for each in entry.run.summary.get("relocalisations", ())
    ]
    heading = ["frame", "segment", "seen before in", "keyframes", "inliers"]
    heading += [f"moved by ({entry.run.unit})", "turned by (deg)"]
    return _folded(f"Relocalisations, {entry.name}", heading, rows)


def _kind(loop: Mapping[str, Any]) -> str:
    """Kind of a loop, with the id of its marker."""
    number = loop.get("marker")
    return str(loop["kind"]) if number is None else f"{loop['kind']} ({number})"


def markers(entry: Entry) -> Markup:
    """Markers and where they are, if there are any."""
    rows = [
        [str(each.id), str(each.segment), *(f"{value:.3f}" for value in each.position)]
        + [number(1000.0 * each.sigma_m), str(each.views)]
        + [_range(each.first_frame, each.last_frame), number(each.error)]
        for each in entry.run.markers
    ]
    heading = ["id", "segment", "x (m)", "y (m)", "z (m)", "sigma (mm)", "views", "frames"]
    return _folded(f"Markers, {entry.name}", [*heading, "error (sigma)"], rows)


def _moved(value: float | None) -> str:
    return "–" if value is None else number(value)


def settings(entries: Sequence[Entry]) -> Markup:
    """Settings that differ from the defaults, and all settings of each run."""
    parts = [element("h2", "Settings")]
    changed = changed_settings([entry.run.config for entry in entries], Config())
    if changed:
        rows = [[name, *values] for name, values in changed.items()]
        parts.append(
            table(["different from the default", *(entry.name for entry in entries)], rows)
        )
    else:
        parts.append(element("p", "All settings have their default values."))
    for entry in entries:
        text = element("pre", entry.run.config or "config.yaml is missing")
        parts.append(element("details", element("summary", f"config.yaml of {entry.name}"), text))
    return element("section", *parts)


def provenance(entries: Sequence[Entry]) -> Markup:
    """Recordings, frames and software versions of the runs."""
    keys = list(dict.fromkeys(key for e in entries for key in e.run.summary["versions"]))
    rows = [
        ["source", *(str(e.run.summary["source"]) for e in entries)],
        ["folder", *(str(e.run.path.resolve()) for e in entries)],
        ["frames", *(_requested_frames(e) for e in entries)],
        ["seed", *(str(e.run.summary["seed"]) for e in entries)],
        *([key, *(str(e.run.summary["versions"].get(key, "–")) for e in entries)] for key in keys),
    ]
    return _folded("Recordings and versions", ["", *(entry.name for entry in entries)], rows)


def _requested_frames(entry: Entry) -> str:
    summary = entry.run.summary
    stride = f", every {summary['stride']}." if summary["stride"] != 1 else ""
    return f"{summary['start']} to {summary['end']}{stride}"
