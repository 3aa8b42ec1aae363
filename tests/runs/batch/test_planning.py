"""From sources to jobs: what is found, names, and manifests."""

from __future__ import annotations

import csv
import json
import os
import re
from pathlib import Path

import pytest

from vo.base.errors import ConfigError, SourceError
from vo.runs.batch.job import Job
from vo.runs.batch.planning import plan

OPTIONS = Job("", "")


def names_of(*sources: Path | str, manifest: Path | None = None) -> list[str]:
    return [job.name for job in plan([str(each) for each in sources], OPTIONS, manifest).jobs]


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    """Two logs of the same name, a video, an empty folder, and a folder without a recording."""
    for name in ("mon/front.mcap", "tue/front.mcap", "clip.MP4", "notes/readme.txt"):
        path = tmp_path / "drives" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    (tmp_path / "drives" / "lost").mkdir()
    return tmp_path / "drives"


def test_all_recordings_below_a_folder_are_found(drives: Path) -> None:
    planned = plan([str(drives)], OPTIONS)
    assert [job.name for job in planned.jobs] == ["clip", "lost", "mon_front", "tue_front"]
    assert planned.left_out == (str(drives / "notes"),)


def test_equal_names_are_told_apart_and_listed(drives: Path) -> None:
    planned = plan([str(drives)], OPTIONS)
    assert planned.renamed == {
        "mon_front": str(drives / "mon" / "front.mcap"),
        "tue_front": str(drives / "tue" / "front.mcap"),
    }


def test_names_that_differ_in_case_alone_are_told_apart(tmp_path: Path) -> None:
    sources = [tmp_path / "a" / "Walk.mcap", tmp_path / "b" / "walk.mcap"]
    assert names_of(*sources) == ["a_Walk", "b_walk"]


def test_the_same_recording_with_other_settings_has_a_number(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    table.write_text("source,config\nw.mcap,fast\nw.mcap,accurate\n")
    found = names_of(manifest=table)
    assert len(set(found)) == 2
    assert found[1] == f"{found[0]}_2"


def test_a_recording_that_is_given_twice_runs_once(tmp_path: Path) -> None:
    assert names_of(tmp_path / "w.mcap", tmp_path / "w.mcap") == ["w"]


@pytest.mark.parametrize(
    "name", ["failed.mcap", "batch.json.mcap", "..mcap", "é ü.mcap", "-o.mcap"]
)
def test_no_name_is_that_of_another_file_or_outside(tmp_path: Path, name: str) -> None:
    [found] = names_of(tmp_path / name)
    assert found not in ("failed", "batch.json", "batch.csv", "index.html", "", ".", "..")
    assert found == Path(found).name
    assert not found.startswith(("-", "."))
    assert found.isascii()


@pytest.mark.parametrize("suffix", [".csv", ".json"])
@pytest.mark.parametrize(
    "name", ["/etc/vo", "../x", "a/b", "..", ".", "failed", "-o", "a\\b", "a\nb", "~"]
)
def test_names_of_a_manifest_are_names_of_folders(tmp_path: Path, name: str, suffix: str) -> None:
    table = tmp_path / f"table{suffix}"
    if suffix == ".csv":
        with table.open("w", newline="") as file:
            csv.writer(file).writerows([["source", "name"], ["w.mcap", name]])
    else:
        table.write_text(json.dumps([{"source": "w.mcap", "name": name}]))
    planned = plan([], OPTIONS, table)
    [found] = [job.name for job in planned.jobs]
    assert re.fullmatch("[A-Za-z0-9_][A-Za-z0-9._-]*", found)
    assert found != "failed"
    assert list(planned.renamed) == [found]


def test_long_names_are_cut(tmp_path: Path) -> None:
    found = names_of(tmp_path / ("a" * 250 + ".mcap"), tmp_path / ("b" + "a" * 249 + ".mcap"))
    assert len(set(found)) == 2
    assert max(map(len, found)) < 130


def test_a_pattern_gives_its_matches_and_images_stay_together(drives: Path) -> None:
    assert names_of(f"{drives}/*/front.mcap") == ["mon_front", "tue_front"]
    for number in range(3):
        (drives / f"{number}.png").write_bytes(b"x")
    assert len(names_of(f"{drives}/*.png")) == 1


def test_a_missing_recording_is_a_job_that_will_fail(tmp_path: Path) -> None:
    assert names_of(tmp_path / "missing.mcap") == ["missing"]


def test_pipes_and_links_to_nothing_are_not_overlooked(drives: Path) -> None:
    os.mkfifo(drives / "pipe.mcap")
    (drives / "gone.mcap").symlink_to("nowhere")
    assert {"pipe", "gone"} <= set(names_of(drives))


def test_a_manifest_has_options_and_tags(tmp_path: Path) -> None:
    table = tmp_path / "drives.csv"
    table.write_text(
        "source,name,mode,set,start,end,calibration,weather\n"
        "a.mcap,first,mono,features.count=500;tracking.every=2,10,90,c.yaml,rain\n"
        "s3://bucket/b.mcap,,,,,,,\n"
    )
    first, second = plan([], OPTIONS, table).jobs
    assert first == Job(
        "first",
        str(tmp_path / "a.mcap"),
        overrides=("features.count=500", "tracking.every=2"),
        mode="mono",
        calibration=str(tmp_path / "c.yaml"),
        start=10,
        end=90,
        tags={"weather": "rain"},
    )
    assert second == Job("b", "s3://bucket/b.mcap")


def test_a_manifest_in_json_is_the_same(tmp_path: Path) -> None:
    rows = [{"source": "a.mcap", "set": ["features.count=500"], "tags": {"weather": "rain"}}]
    for number, values in enumerate((rows, {"jobs": rows})):
        table = tmp_path / f"{number}.json"
        table.write_text(json.dumps(values))
        [job] = plan([], OPTIONS, table).jobs
        assert job == Job(
            "a",
            str(tmp_path / "a.mcap"),
            overrides=("features.count=500",),
            tags={"weather": "rain"},
        )


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("name,mode\na,mono\n", ConfigError, "recording 1 has no source"),
        ("source,mode\na.mcap,twin\n", ConfigError, "mode is 'twin'"),
        ("source,start\na.mcap,-1\n", ConfigError, "start is -1, which is too small"),
        ("source,stride\na.mcap,0\n", ConfigError, "stride is 0, which is too small"),
        ("source,end\na.mcap,soon\n", ConfigError, "end is 'soon'"),
        ("source\n", SourceError, "there is no recording"),
        ("", SourceError, "there is no recording"),
        ("source\na\0.mcap\n", (ConfigError, SourceError), "t.csv"),
    ],
)
def test_wrong_rows_are_one_line(
    tmp_path: Path, text: str, error: type[Exception], message: str
) -> None:
    table = tmp_path / "t.csv"
    table.write_text(text)
    with pytest.raises(error, match=message) as raised:
        plan([], OPTIONS, table)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("text", ["{", "[1, 2]", '"a"', "[" * 100000, '{"jobs": 3}'])
def test_damaged_json_is_one_line(tmp_path: Path, text: str) -> None:
    table = tmp_path / "t.json"
    table.write_text(text)
    with pytest.raises(SourceError, match=r"manifest .*t\.json"):
        plan([], OPTIONS, table)


def test_a_manifest_of_other_bytes_or_missing_is_one_line(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    with pytest.raises(SourceError, match="cannot be read"):
        plan([], OPTIONS, table)
    table.write_bytes(b"source\n\xff\xfe\x00\n")
    with pytest.raises((SourceError, ConfigError), match=r"t\.csv"):
        plan([], OPTIONS, table)
