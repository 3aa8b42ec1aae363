"""Recordings by URL; `file://` is a file system of fsspec like those of object stores."""

from __future__ import annotations

from pathlib import Path

import pytest

from vo.base.errors import SourceError
from vo.runs.batch.execution import Limits, run_job
from vo.runs.batch.job import Job
from vo.runs.batch.object_store import identity, list_recordings, local_copy
from vo.runs.batch.planning import plan

pytest.importorskip("fsspec", reason="needs the extra cluster")


def test_a_run_on_a_url_has_the_bytes_of_a_run_on_the_path(walks: Path, tmp_path: Path) -> None:
    sources = {"path": str(walks / "walk0"), "url": f"file://{walks}/walk0"}
    for name, source in sources.items():
        result = run_job(Job(name, source, "fast"), tmp_path, Limits())
        assert (result.status.value, result.error) == ("done", None)
        assert (result.source, result.ate_m is None) == (source, False)
    for file in ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv"):
        assert (tmp_path / "url" / file).read_bytes() == (tmp_path / "path" / file).read_bytes()


def test_what_is_below_a_folder_is_listed_by_url(tmp_path: Path) -> None:
    for name in ("b.mcap", "a/x.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    url = f"file://{tmp_path}"
    assert list_recordings(f"{url}/") == [f"{url}/a", f"{url}/b.mcap"]
    assert list_recordings(f"{url}/*.mcap") == [f"{url}/b.mcap"]
    assert list_recordings(f"{url}/b.mcap") == [f"{url}/b.mcap"]
    assert [job.name for job in plan([f"{url}/"], Job("", "")).jobs] == ["a", "b"]


def test_an_identity_changes_with_a_file(tmp_path: Path) -> None:
    file = tmp_path / "log.mcap"
    file.write_bytes(b"one")
    before = identity(f"file://{file}")
    assert identity(f"file://{file}") == before
    file.write_bytes(b"other")
    assert identity(f"file://{file}") != before


@pytest.mark.parametrize("url", ["file:///nowhere/at/all", "nosuchstore://bucket/drive"])
def test_what_is_missing_or_unknown_is_one_error_line(url: str) -> None:
    with pytest.raises(SourceError) as caught, local_copy(url):
        pass
    assert url in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_error_names_the_url_not_the_copy(tmp_path: Path) -> None:
    (tmp_path / "bad.mcap").write_bytes(b"x")
    url = f"file://{tmp_path}/bad.mcap"
    result = run_job(Job("bad", url), tmp_path / "out", Limits())
    assert result.status.value == "failed"
    assert (result.error or "").startswith(f"{url} is not an MCAP file")
