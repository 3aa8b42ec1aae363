"""Content of the page of `vo report`, also for incomplete and damaged runs."""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_changes import change_summary
from typer.testing import CliRunner

from vo.base.geometry.geodesy import geodetic_from_enu
from vo.base.types import Trajectory
from vo.cli.app import app
from vo.outputs.evaluation.evaluation import evaluate
from vo.outputs.evaluation.inputs import load_inputs
from vo.outputs.report import markup, sections
from vo.outputs.report.entry import Entry
from vo.outputs.report.markup import duration, length, number, percentage
from vo.outputs.report.run_folder import read_run
from vo.outputs.report.verdict import verdict
from vo.recordings.formats.trajectory import read_tum, write_tum


class Page(HTMLParser):
    """Text of a page without figures and style, its ids, and the addresses it refers to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.source = path.read_text(encoding="utf-8")
        self.ids: list[str] = []
        self.loads: list[str] = []
        self.open: list[str] = []
        self.words: list[str] = []
        self.images = 0
        self.feed(self.source)
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.open.append(tag)
        self.images += tag == "img"
        for name, value in attributes:
            if name == "id" and value:
                self.ids.append(value)
            if name in ("src", "href", "xlink:href", "srcset") and value:
                self.loads.append(value)

    def handle_endtag(self, tag: str) -> None:
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if not {"svg", "style", "script"} & set(self.open):
            self.words.append(data)


def make(*arguments: str | Path, expect: int = 0) -> str:
    result = CliRunner().invoke(app, ["report", *map(str, arguments)])
    assert result.exit_code == expect, result.output
    return " ".join(result.output.split())


def page_of(tmp_path: Path, *arguments: str | Path) -> Page:
    make(*arguments, "-o", tmp_path / "report.html")
    return Page(tmp_path / "report.html")


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn and not converted to SVG, which takes most of the time of a page."""
    empty = markup.Markup("<svg></svg>")
    monkeypatch.setattr(sections, "inline_svg", lambda figure, prefix, caption: empty)


@pytest.mark.usefixtures("without_figures")
def test_a_page_contains_the_numbers_of_its_run(
    report_runs: list[Path], synthetic_stereo: Path, tmp_path: Path
) -> None:
    page = page_of(tmp_path, report_runs[0])
    inputs = load_inputs(report_runs[0], synthetic_stereo / "groundtruth.tum")
    found = evaluate(inputs.estimate, inputs.reference, mode="stereo")
    summary = json.loads((report_runs[0] / "summary.json").read_text(encoding="utf-8"))
    assert f"All {summary['frames']} frames have a pose" in page.text
    assert f"ATE {length(found.ate.translation.rmse)}" in page.text
    causal = read_tum(report_runs[0] / "causal.tum")
    then = evaluate(causal, inputs.reference, mode="stereo").ate.translation.rmse
    assert f"ATE, causal {length(then)}" in page.text
    assert found.rpe_frames is not None
    assert f"RPE {length(found.rpe_frames.translation.rmse)}" in page.text
    assert f"keyframes {summary['keyframes']}" in page.text
    assert f"memory {summary['peak_rss_mb']:.0f} MB" in page.text
    assert "features.count" in page.text  # changed by `fast`
    assert page.images >= 2
    for name in (
        "path",
        "positions",
        "angles",
        "error_time",
        "error_distance",
        "rpe",
        "uncertainty",
        "counts",
        "stages",
    ):
        assert f"plot-{name}" in page.ids


def test_a_page_is_self_contained(report_runs: list[Path], tmp_path: Path) -> None:
    page = page_of(tmp_path, *report_runs)
    assert page.loads
    assert all(value.startswith(("#", "data:")) for value in page.loads)
    assert "url(http" not in page.source and "@import" not in page.source
    assert page.source.count("<script>") == 1
    addresses = re.findall(r"https?://[^'\"<\s]*", page.source)
    assert all(each.startswith("http://www.w3.org/") for each in addresses)
    assert [name for name, count in Counter(page.ids).items() if count > 1] == []
    references = set(re.findall(r'(?:url\(|href=")#([^")]+)', page.source))
    assert references <= set(page.ids)
    assert len(page.source) < 1_500_000


@pytest.mark.usefixtures("without_figures")
def test_several_runs_are_compared_in_one_table(report_runs: list[Path], tmp_path: Path) -> None:
    page = page_of(tmp_path, *report_runs)
    assert "2 runs compared" in page.text
    rows = re.findall(r"<tr>.*?</tr>", page.source)
    ate = next(row for row in rows if 'scope="row">ATE<' in row)
    assert "se3" in ate and "sim3" in ate
    assert {"plot-inliers", "plot-times", "plot-counts_1", "plot-counts_2"} <= set(page.ids)


def test_a_run_has_the_same_colour_in_all_figures(
    report_runs: list[Path], own_run: Path, tmp_path: Path
) -> None:
    change_summary(own_run, source="gone")
    (own_run / "covariance.csv").unlink()
    page = page_of(tmp_path, own_run, report_runs[0])
    for name in ("error_time", "uncertainty"):
        figure = page.source[page.source.index(f'id="plot-{name}"') :].partition("</figure>")[0]
        assert "var(--series-1)" in figure and "var(--series-0)" not in figure


def test_names_are_escaped(report_runs: list[Path], tmp_path: Path) -> None:
    odd = tmp_path / '<img src=x onerror=alert(1)> & "quotes" $x_1$ 中'
    hidden = tmp_path / "_hidden"
    for copy in (odd, hidden):
        shutil.copytree(report_runs[0], copy)
    change_summary(odd, source="<script>alert(2)</script>", warnings=["<b>x</b>"])
    page = page_of(tmp_path, odd, report_runs[1], hidden)
    assert "\u2009_hidden</text>" in page.source
    assert "<script>alert" not in page.source and "<b>x" not in page.source
    assert page.source.count("<script") == 3  # the page's own, and the data of two views
    assert "<img src=x" not in page.source
    assert odd.name in page.text


def test_times_without_tracking_are_shaded(own_run: Path, tmp_path: Path) -> None:
    whole = page_of(tmp_path, own_run)
    rows = (own_run / "frames.csv").read_text(encoding="utf-8").splitlines()
    rows[6:9] = [row.replace(",tracking,", ",lost,") for row in rows[6:9]]
    (own_run / "frames.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    lost = {"first": 5, "last": 7, "frames": 3, "state": "lost", "reason": "a <dark> tunnel"}
    change_summary(own_run, tracked=11, lost=3, without_pose=[lost])
    page = page_of(tmp_path, own_run)
    assert "11 of 14 frames have a pose (78.5 %)" in page.text
    assert "with gaps" in page.text and "a <dark> tunnel" in page.text
    assert "lost: frame 5" in page.text and "recovered: frame 8" in page.text
    assert page.source.count("var(--lost)") > whole.source.count("var(--lost)")
    assert ">no pose</text>" in page.source


@pytest.mark.usefixtures("without_figures")
def test_runs_of_different_recordings_have_separate_path_figures(
    own_run: Path, tmp_path: Path
) -> None:
    other = Path(shutil.copytree(own_run, tmp_path / "other"))
    change_summary(other, source="another/recording")
    page = page_of(tmp_path, own_run, other)
    assert {"plot-path_1", "plot-path_2"} <= set(page.ids)
    assert "another/recording" in page.text


def views_of(page: Page) -> list[Any]:
    """Data of the 3D views."""
    found = re.findall(r'<script type="application/json">(.*?)</script>', page.source)
    return [json.loads(text) for text in found]


@pytest.mark.usefixtures("without_figures")
def test_the_view_has_the_values_of_the_run(
    report_runs: list[Path], synthetic_stereo: Path, tmp_path: Path
) -> None:
    page = page_of(tmp_path, *report_runs, "--no-images")
    (view,) = views_of(page)
    assert [run["name"] for run in view["runs"]] == ["stereo", "mono"]
    for folder, run in zip(report_runs, view["runs"], strict=True):
        inputs = load_inputs(folder, synthetic_stereo / "groundtruth.tum")
        found = evaluate(inputs.estimate, inputs.reference, mode=inputs.mode)
        aligned = found.alignment.reference_from_estimate.transform_poses(
            read_run(folder).trajectory.world_from_cam
        )[:, :3, 3]
        shown = np.array(run["points"]).reshape(-1, 3)
        columns = [view["names"].index(name) for name in "xyz" if name in view["names"]]
        known = [axis for axis, name in enumerate("xyz") if name in view["names"]]
        assert np.allclose(shown[:, columns], aligned[:, known], atol=1e-4)
        errors = [each for each in run["error"] if each is not None]
        assert np.allclose(errors, found.ate.translation_m, atol=1e-5)
        steps = np.linalg.norm(np.diff(aligned, axis=0), axis=1) / np.diff(run["time"])
        assert run["speed"][5] == pytest.approx(0.5 * (steps[4] + steps[5]), rel=1e-2)
    sigmas = read_run(report_runs[0]).sigmas
    assert sigmas is not None
    row = view["runs"][0]["frame"].index(int(read_run(report_runs[0]).frames.frame[0]))
    assert view["runs"][0]["sigma"][row] == pytest.approx(sigmas.position[0], abs=1e-5)


def test_every_picture_has_a_text(report_runs: list[Path], tmp_path: Path) -> None:
    source = page_of(tmp_path, report_runs[0]).source
    for picture in re.findall(r"<svg.*?</svg>", source, re.DOTALL):
        assert re.search(r"<title>[^<]{20,}</title>", picture)
    assert all(len(text) > 10 for text in re.findall(r'<img [^>]*alt="([^"]*)"', source))
    (text,) = re.findall(r'<canvas[^>]* aria-label="([^"]*)"', source)
    assert text.startswith("Camera path in 3D. stereo: extent ") and "error " in text


def test_a_long_path_is_thinned_and_says_so(own_run: Path, tmp_path: Path) -> None:
    count = 40_000
    rng = np.random.default_rng(1)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = np.cumsum(rng.normal(0.02, 0.05, (count, 3)), axis=0)
    stamps = np.arange(count) * 50_000_000
    write_tum(own_run / "trajectory.tum", Trajectory(stamps, poses))
    head, row = (own_run / "frames.csv").read_text().splitlines()[:2]
    tail = row.split(",", 2)[2]
    rows = [f"{n},{stamp},{tail}" for n, stamp in enumerate(stamps.tolist())]
    (own_run / "frames.csv").write_text("\n".join([head, *rows, ""]))
    (own_run / "covariance.csv").unlink()
    change_summary(own_run, source="gone", frames=count, tracked=count, segments=[])
    page = page_of(tmp_path, own_run, "--no-images")
    assert len(page.source) < 3_000_000
    assert "Of 40000 poses, 4000 are shown" in page.text
    (view,) = views_of(page)
    run = view["runs"][0]
    assert 3000 < len(run["time"]) <= 4001 and run["frame"][-1] == count - 1
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / 0.05
    assert max(run["speed"]) == pytest.approx(0.5 * (steps[1:] + steps[:-1]).max(), rel=1e-3)


def test_a_georeferenced_run_is_shown_on_a_map(own_run: Path, tmp_path: Path) -> None:
    path = read_tum(own_run / "trajectory.tum")
    turned = path.positions[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    degrees = geodetic_from_enu(turned, np.array([49.0, 8.4, 110.0]))
    line = {"type": "LineString", "coordinates": degrees[:, [1, 0, 2]].tolist()}
    properties = {"segment": 0, "stamps_ns": path.stamps_ns.tolist()}
    feature = {"type": "Feature", "properties": properties, "geometry": line}
    text = json.dumps({"type": "FeatureCollection", "features": [feature]})
    (own_run / "path.geojson").write_text(text, encoding="utf-8")
    page = page_of(tmp_path, own_run, "--no-images")
    (view,) = views_of(page)
    assert view["isMap"] and view["names"] == ["east", "north", "up"]
    shown = np.array(view["runs"][0]["points"]).reshape(-1, 3)
    assert np.allclose(shown, turned - turned[0], atol=2e-3)
    assert len(view["truth"]) > 30 and ">north (m)<" in page.source
    (own_run / "path.geojson").write_text(text.replace("coordinates", "places"), encoding="utf-8")
    assert "path.geojson is damaged" in make(own_run, expect=1)


@pytest.mark.usefixtures("without_figures")
def test_a_run_with_gps_is_shown_on_a_map_of_its_positions(own_run: Path, tmp_path: Path) -> None:
    path = read_tum(own_run / "trajectory.tum")
    turned = path.positions[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    degrees = geodetic_from_enu(turned, np.array([49.0, 8.4, 110.0]))
    heading = "stamp_ns,segment,tx,ty,tz,latitude,longitude,height"
    rows = zip(path.stamps_ns, path.positions.tolist(), degrees.tolist(), strict=True)
    lines = [",".join(map(str, (stamp, 0, *xyz, *globe))) for stamp, xyz, globe in rows]
    table = own_run / "given_positions.csv"
    table.write_text("\n".join([heading, *lines, ""]), encoding="utf-8")
    page = page_of(tmp_path, own_run, "--no-images")
    (view,) = views_of(page)
    assert view["isMap"] and view["names"] == ["east", "north", "up"] and view["givenName"] == "GPS"
    for points in (view["given"], view["runs"][0]["points"]):
        shown = np.array(points).reshape(-1, 3)
        assert np.allclose(shown, turned - turned[0], atol=2e-3)
    assert f"{len(lines)} positions: GPS" in page.source
    metres = [",".join([*line.split(",")[:5], "", "", ""]) for line in lines]
    table.write_text("\n".join([heading, *metres, ""]), encoding="utf-8")
    (view,) = views_of(page_of(tmp_path, own_run, "--no-images"))
    assert not view["isMap"] and view["givenName"] == "given positions"
    assert len(view["given"]) == 3 * len(lines)
    table.write_text(table.read_text(encoding="utf-8").replace(",0,", ",zero,", 1))
    assert "given_positions.csv is damaged" in make(own_run, expect=1)


def segment_records(
    run: Path, spans: list[tuple[int, int]], frames: list[int]
) -> list[dict[str, int | float]]:
    """Segments of `summary.json` with given first and last frames and numbers of frames."""
    stamps = read_tum(run / "trajectory.tum").stamps_ns
    return [
        {
            "segment": number,
            "first_frame": first,
            "last_frame": last,
            "first_stamp_ns": int(stamps[first]),
            "last_stamp_ns": int(stamps[last]),
            "frames": frames[number],
            "path_m": 0.4,
        }
        for number, (first, last) in enumerate(spans)
    ]


@pytest.mark.usefixtures("without_figures")
def test_each_segment_is_aligned_separately(own_run: Path, tmp_path: Path) -> None:
    segments = segment_records(own_run, [(0, 7), (8, 13)], frames=[8, 6])
    change_summary(own_run, segments=segments)
    table = own_run / "poses.csv"
    head, *rows = [line.split(",") for line in table.read_text().splitlines()]
    column = head.index("segment")
    rows = [[*row[:column], str(int(int(row[0]) > 7)), *row[column + 1 :]] for row in rows]
    table.write_text("".join(f"{','.join(row)}\n" for row in [head, *rows]))
    page = page_of(tmp_path, own_run)
    assert "in 2 segments that are not connected" in page.text
    assert "The longest segment (8 poses)" in page.text
    assert "each of the other segments is aligned separately" in page.text
    assert "Segments, run" in page.text


def test_segments_of_a_world_may_have_another_one_in_between(own_run: Path) -> None:
    segments = segment_records(own_run, [(0, 9), (4, 13)], frames=[7, 7])
    change_summary(own_run, segments=segments)
    numbers = [0] * 4 + [1] * 3 + [0] * 3 + [1] * 4
    table = own_run / "poses.csv"
    head, *rows = [line.split(",") for line in table.read_text().splitlines()]
    column = head.index("segment")
    rows = [
        [*row[:column], str(n), *row[column + 1 :]] for row, n in zip(rows, numbers, strict=True)
    ]
    table.write_text("".join(f"{','.join(row)}\n" for row in [head, *rows]))
    stamps = read_tum(own_run / "trajectory.tum").stamps_ns
    assert read_run(own_run).segment_of(stamps).tolist() == numbers


@pytest.mark.usefixtures("without_figures")
def test_a_killed_run_is_shown(own_run: Path, tmp_path: Path) -> None:
    for name in ("trajectory.tum", "causal.tum", "covariance.csv", "frames.csv"):
        (own_run / name).rename(own_run / f"{name}.partial")
    change_summary(own_run, status="interrupted")
    page = page_of(tmp_path, own_run)
    assert "interrupted" in page.text
    assert "plot-counts" in page.ids


def test_a_run_without_frames_or_covariances_is_shown(own_run: Path, tmp_path: Path) -> None:
    for name in ("frames.csv", "covariance.csv", "config.yaml", "causal.tum"):
        (own_run / name).unlink()
    page = page_of(tmp_path, own_run)
    assert {"plot-path", "plot-error_time"} <= set(page.ids)
    assert not {"plot-counts", "plot-uncertainty"} & set(page.ids)


@pytest.mark.parametrize(
    ("tracked", "grade", "word"),
    [
        (14, "good", "complete"),
        (13, "caution", "with gaps"),
        (6, "bad", "mostly lost"),
        (0, "bad", "no path"),
    ],
)
def test_the_verdict_depends_on_the_number_of_tracked_frames(
    own_run: Path, tracked: int, grade: str, word: str
) -> None:
    change_summary(own_run, tracked=tracked)
    found = verdict(Entry("a", 0, read_run(own_run)))
    assert (found.grade, found.word) == (grade, word)
    assert any("There is no ground truth" in each for each in found.sentences) == (tracked > 0)


def test_starting_frames_that_have_a_pose_by_now_are_not_shaded_as_lost(
    report_runs: list[Path],
) -> None:
    """Those of one camera have no pose until the first map."""
    entry = Entry("a", 0, read_run(report_runs[1]))
    frames = entry.run.frames
    assert frames is not None and frames.state[0] == "starting"
    assert entry.run.trajectory.stamps_ns[0] == frames.stamp_ns[0]
    assert len(entry.untracked_s) == 1
    assert entry.without_pose_s == []


def test_a_run_without_a_pose_is_shown(own_run: Path, tmp_path: Path) -> None:
    for name in ("trajectory.tum", "causal.tum"):
        (own_run / name).write_text("", encoding="utf-8")
    changed = {"tracked": 0, "segments": [], "path_m": 0.0, "median_inliers": None}
    change_summary(own_run, **changed)
    page = page_of(tmp_path, own_run)
    assert "None of the 14 frames has a pose" in page.text
    assert "plot-path" not in page.ids


@pytest.mark.usefixtures("without_figures")
def test_ground_truth_may_be_given_or_missing(
    own_run: Path, synthetic_stereo: Path, tmp_path: Path
) -> None:
    change_summary(own_run, source=str(tmp_path / "gone"))
    page = page_of(tmp_path, own_run)
    assert "can no longer be read" in page.text and "ATE" not in page.text
    assert page.images == 0
    true = read_tum(synthetic_stereo / "groundtruth.tum")
    write_tum(tmp_path / "mine.txt", true)
    assert "ATE" in page_of(tmp_path, own_run, "--truth", tmp_path / "mine.txt").text
    assert "ATE" in page_of(tmp_path, own_run, "--truth", synthetic_stereo).text
    assert "does not exist" in make(own_run, "--truth", tmp_path / "no.txt", expect=1)


def test_plots_are_written_as_pdf_and_png(report_runs: list[Path], tmp_path: Path) -> None:
    output, plots = tmp_path / "deep" / "a.html", tmp_path / "plots"
    make(report_runs[0], "-o", output, "--picture", plots, "--no-images")
    assert Page(output).images == 0
    names = {path.stem for path in plots.glob("*.pdf")}
    assert names == {path.stem for path in plots.glob("*.png")}
    assert {"path", "error_time", "rpe", "counts", "stages"} <= names
    assert all(path.stat().st_size > 3000 for path in plots.iterdir())


@pytest.mark.parametrize("content", [None, "no json", "[]", '{"frames": 1}'])
def test_a_folder_that_is_not_a_run_is_refused(content: str | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "summary.json").write_text(content, encoding="utf-8")
    assert "error: " in make(tmp_path, "-o", tmp_path / "r.html", expect=1)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("source", 5), ("tracked", "all"), ("segments", None), ("versions", []), ("wall_s", "1")],
        *[("path_m", 10**400), ("frames", True), ("seed", 2**63), ("error", 1), ("mode", None)],
    ],
)
def test_a_summary_with_wrong_types_is_refused(own_run: Path, name: str, value: object) -> None:
    change_summary(own_run, **{name: value})
    assert f"summary.json: '{name}' is {repr(value)[:80]}, not " in make(own_run, expect=1)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"path_m": None}, "'segments[0].path_m' is None, not a number;"),
        ({"frames": 1.5}, "'segments[0].frames' is 1.5, not a whole number;"),
        ({"frames": ...}, "'segments[0].frames' is missing;"),
    ],
)
def test_a_wrong_value_in_a_list_is_named(
    own_run: Path, change: dict[str, object], told: str
) -> None:
    (segment,) = json.loads((own_run / "summary.json").read_text(encoding="utf-8"))["segments"]
    kept = {name: value for name, value in {**segment, **change}.items() if value is not ...}
    change_summary(own_run, segments=[kept])
    assert told in make(own_run, expect=1)


@pytest.mark.usefixtures("without_figures")
def test_a_report_replaces_only_html_pages(own_run: Path, tmp_path: Path) -> None:
    before = (own_run / "trajectory.tum").read_bytes()
    output = make(own_run, "-o", own_run / "trajectory.tum", expect=1)
    assert "trajectory.tum is not a report and would be replaced" in output
    assert (own_run / "trajectory.tum").read_bytes() == before
    for _ in range(2):
        make(own_run, "-o", tmp_path / "r.html", "--no-images")


@pytest.mark.usefixtures("without_figures")
@pytest.mark.parametrize("name", ["frames.csv", "covariance.csv", "trajectory.tum", "causal.tum"])
def test_only_a_truncated_line_is_ignored(own_run: Path, tmp_path: Path, name: str) -> None:
    whole = (own_run / name).read_bytes()
    partial = own_run / f"{name}.partial"
    partial.write_bytes(whole[: whole.rindex(b"\n", 0, -1) + 8])
    (own_run / name).unlink()
    result = CliRunner().invoke(app, ["report", str(own_run), "-o", str(tmp_path / "r.html")])
    assert result.exit_code == 0, result.output
    assert result.stderr.count(f"{name}.partial") == 1
    assert "cut off" in result.stderr


def test_the_error_names_the_damaged_file(own_run: Path, tmp_path: Path) -> None:
    rows = (own_run / "frames.csv").read_text(encoding="utf-8").replace("tracking,0", "tracking")
    (own_run / "frames.csv").write_text(rows, encoding="utf-8")
    assert "frames.csv is damaged" in make(own_run, "-o", tmp_path / "r.html", expect=1)


@pytest.mark.usefixtures("without_figures")
def test_a_report_that_cannot_be_written_is_an_error(own_run: Path, tmp_path: Path) -> None:
    assert "cannot be written" in make(own_run, "-o", tmp_path, expect=1)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1234.5, "1234"), (12.345, "12.3"), (-0.0123, "−0.0123"), (float("nan"), "–")],
)
def test_numbers_are_short(value: float, text: str) -> None:
    assert number(value) == text


def test_units_fit_the_size_of_quantities() -> None:
    assert [length(v) for v in (12.34, 0.1234, 0.00123)] == ["12.3 m", "12.3 cm", "1.23 mm"]
    assert length(0.5, "map units") == "0.500 map units"
    assert [duration(v) for v in (5.0, 300.0, 7200.0)] == ["5.00 s", "5.00 min", "2.00 h"]
    assert [percentage(p, 2000) for p in (2000, 1999, 0)] == ["100 %", "99.9 %", "0 %"]
    assert np.isclose(float(number(3.14159)), 3.14)


def test_markers_are_drawn_and_listed(own_run: Path, tmp_path: Path) -> None:
    header = "segment,id,tx,ty,tz,qx,qy,qz,qw,sigma_m,views,first_frame,last_frame,error"
    rows = ["0,7,1.25,0.5,2.125,0,0,0,1,0.0042,9,1,12,1.5", "0,23,-1,0,3,0,0,0,1,0.01,3,4,6,0.9"]
    (own_run / "markers.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    page = page_of(tmp_path, own_run, "--no-images")
    (figure,) = re.findall(r'<figure id="plot-path">.*?</figure>', page.source, re.DOTALL)
    assert ">7<" in figure and ">23<" in figure
    assert [name for name, *_ in views_of(page)[0]["runs"][0]["markers"]] == ["7", "23"]
    assert "error (sigma) 7 0 1.250 0.500 2.125 4.20 9 1 to 12 1.50" in page.text
    assert "23 0 -1.000 0.000 3.000 10.0 3 4 to 6 0.900" in page.text
    (own_run / "markers.csv").write_text("\n".join([header, "0,7,x", ""]), encoding="utf-8")
    assert "markers.csv is damaged" in make(own_run, expect=1)


@pytest.mark.usefixtures("without_figures")
def test_a_run_without_markers_has_no_table_of_them(own_run: Path, tmp_path: Path) -> None:
    assert "Markers" not in page_of(tmp_path, own_run, "--no-images").text
