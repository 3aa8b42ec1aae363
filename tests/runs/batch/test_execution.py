"""Jobs in processes of their own: what they cost each other, and what is kept."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from vo.base.config import load_config
from vo.base.errors import OutputError
from vo.runs.batch import execution
from vo.runs.batch.batch import LocalEngine, run_batch
from vo.runs.batch.execution import Limits, run_job
from vo.runs.batch.job import Job, JobResult, JobStatus
from vo.runs.batch.planning import plan
from vo.runs.batch.tables import read_batch
from vo.runs.run_recording import run

VO = Path(sys.executable).with_name("vo")
SAME_BYTES = ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv")
OPTIONS = Job("", "", "fast")
TIMES = {"wall_s", "cpu_s", "frames_per_s", "peak_rss_mb", "attempts"}


def batch(sources: Path, output: Path, *, jobs: int = 2, **limits: Any) -> list[JobResult]:
    engine = LocalEngine(jobs, Limits(**limits))
    return list(run_batch(plan([str(sources)], OPTIONS), output, engine).results)


def started(sources: Path, output: Path, *words: str) -> subprocess.Popen[str]:
    command = [VO, "batch", sources, "-o", output, "--config", "fast", "--jobs", "1", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finished(output: Path) -> dict[str, int]:
    """Modification times of all results under their final name."""
    return {path.parent.name: path.stat().st_mtime_ns for path in output.glob("*/result.json")}


def wait_until(condition: Any, seconds: float = 90.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)


def workers() -> set[int]:
    """Child processes that run a job; one that is stopped before its exec blocks its parent."""
    found: set[int] = set()
    for path in Path("/proc/self/task").glob("*/children"):
        found |= {int(word) for word in path.read_text().split()}
    return {pid for pid in found if b"vo.runs.batch.worker" in command_line(pid)}


def command_line(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


@pytest.fixture(scope="module")
def results(walks: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of a batch of all three recordings; not to be written to."""
    output = tmp_path_factory.mktemp("batch") / "out"
    assert [each.status for each in batch(walks, output)] == [JobStatus.DONE] * 3
    return output


def test_results_are_those_of_a_run_alone(walks: Path, results: Path, tmp_path: Path) -> None:
    run(str(walks / "walk1"), tmp_path / "alone", config=load_config("fast"))
    for name in SAME_BYTES:
        assert (results / "walk1" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()


def test_tables_have_every_recording(walks: Path, results: Path) -> None:
    values = json.loads((results / "batch.json").read_text())
    assert values["totals"]["by_status"] == {"done": 3}
    assert values["totals"]["frames"] == 24
    assert [each.name for each in read_batch(results)] == ["walk0", "walk1", "walk2"]
    assert all(0.0 < each.ate_m < 0.02 for each in read_batch(results) if each.ate_m is not None)
    assert (results / "batch.csv").read_text().count("\n") == 4
    page = (results / "index.html").read_text()
    assert all(f'href="walk{n}/summary.json"' in page for n in range(3))
    assert sorted(path.name for path in results.iterdir()) == [
        *("batch.csv", "batch.json", "index.html", "walk0", "walk1", "walk2")
    ]


def test_bad_recordings_cost_only_themselves(walks: Path, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    shutil.copytree(walks / "walk0", folder / "good")
    (folder / "empty").mkdir()
    (folder / "cut.mcap").write_bytes(b"\x89MCAP0\r\n")
    (folder / "gone.mcap").symlink_to("nowhere")
    table = folder / "table.csv"
    table.write_text("source\ngood\nempty\ncut.mcap\ngone.mcap\n")
    command = [VO, "batch", "--manifest", table, "-o", tmp_path / "out", "--config", "fast"]
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, check=False)
    assert done.returncode == 4
    found = {each["name"]: each for each in json.loads(done.stdout)["results"]}
    assert {name: each["status"] for name, each in found.items()} == {
        **{"good": "done", "empty": "failed", "cut": "failed", "gone": "failed"}
    }
    assert "no images" in found["empty"]["error"]
    assert "does not exist" in found["gone"]["error"]
    assert all("\n" not in (each["error"] or "") for each in found.values())
    assert "Traceback" not in done.stderr
    assert (tmp_path / "out" / "failed" / "cut" / "result.json").is_file()


def run_with(walk: Path, output: Path, limits: Limits, number: int) -> JobResult:
    """Run a job, and send a signal to each of its processes as soon as it runs."""
    found: list[JobResult] = []
    job = Job("walk", str(walk), "fast")
    known = workers()
    thread = threading.Thread(target=lambda: found.append(run_job(job, output, limits)))
    thread.start()
    for _ in range(limits.retries + 1):
        wait_until(lambda: workers() - known)
        [child] = workers() - known
        os.kill(child, number)
        known.add(child)
    thread.join(60)
    assert not (output / "walk").exists()
    return found[0]


def test_one_that_hangs_is_ended(
    walks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vo.runs.batch.execution._GRACE_S", 0.5)
    result = run_with(walks / "walk0", tmp_path, Limits(timeout_s=1.0, retries=0), signal.SIGSTOP)
    assert result.status is JobStatus.TIMED_OUT
    assert "more than 1 s" in (result.error or "")


def test_one_that_is_killed_is_started_again(walks: Path, tmp_path: Path) -> None:
    result = run_with(walks / "walk0", tmp_path, Limits(retries=1), signal.SIGKILL)
    assert (result.status, result.attempts) == (JobStatus.CRASHED, 2)
    assert "SIGKILL" in (result.error or "")


@pytest.mark.parametrize("place", ["walk0", "failed/walk0"])
def test_a_folder_that_is_not_a_result_is_not_replaced(
    walks: Path, tmp_path: Path, place: str
) -> None:
    mine = tmp_path / "out" / place / "mine.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    found = batch(walks, tmp_path / "out")
    assert [each.status.value for each in found] == ["failed", "done", "done"]
    assert f"{mine.parent} is not a result of an earlier batch" in (found[0].error or "")
    assert mine.read_text() == "mine"
    assert list(mine.parent.iterdir()) == [mine]


def test_tables_of_others_are_not_replaced(walks: Path, tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(OutputError, match="not a result of an earlier batch"):
        batch(walks, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]


def test_one_that_needs_too_much_memory_fails_alone(walks: Path, tmp_path: Path) -> None:
    limits = Limits(memory_mb=400, retries=0)
    result = run_job(Job("walk0", str(walks / "walk0"), "fast"), tmp_path / "out", limits)
    assert result.status in (JobStatus.CRASHED, JobStatus.FAILED)
    assert result.error
    assert "\n" not in result.error


def test_a_batch_that_is_killed_goes_on(walks: Path, results: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    known: dict[str, int] = {}
    for number in range(3):
        process = started(walks, output)
        if number == 0:
            wait_until((output / ".vo-batch-work").is_dir)
        else:
            wait_until(lambda count=number: len(finished(output)) >= count)
        process.kill()
        process.communicate()
        assert known.items() <= finished(output).items()
        known = finished(output)
    process = started(walks, output)
    process.communicate()
    assert process.returncode == 0
    assert known.items() <= finished(output).items()
    assert sorted(finished(output)) == ["walk0", "walk1", "walk2"]
    assert not (output / ".vo-batch-work").exists()
    for name in finished(output):
        for file in SAME_BYTES:
            assert (output / name / file).read_bytes() == (results / name / file).read_bytes()
    for first, second in zip(read_batch(output), read_batch(results), strict=True):
        one, other = first.to_dict(), second.to_dict()
        assert {k: v for k, v in one.items() if k not in TIMES} == {
            k: v for k, v in other.items() if k not in TIMES
        }


def test_finished_results_are_kept_until_something_changes(walks: Path, tmp_path: Path) -> None:
    output, sources = tmp_path / "out", tmp_path / "walks"
    shutil.copytree(walks, sources)
    batch(sources, output)
    before = finished(output)
    planned = plan([str(sources)], OPTIONS)
    os.utime(sources / "walk1" / "mav0" / "cam0" / "data.csv")
    shutil.rmtree(sources / "walk2" / "mav0")
    done = run_batch(planned, output, LocalEngine(2, Limits()))
    after = finished(output)
    assert done.kept == 1
    assert after["walk0"] == before["walk0"]
    assert after["walk1"] > before["walk1"]
    assert [each.status.value for each in done.results] == ["done", "done", "failed"]


def test_ctrl_c_keeps_what_is_finished(walks: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    process = started(walks, output)
    wait_until(lambda: "walk0" in finished(output))
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert [each.status.value for each in read_batch(output)] == ["done", "not run", "not run"]
    assert sorted(finished(output)) == ["walk0"]  # what ran has been ended
    assert not (output / ".vo-batch-work").exists()


def test_two_batches_in_one_folder_are_refused(walks: Path, tmp_path: Path) -> None:
    folder = os.open(tmp_path, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        with pytest.raises(OutputError, match="another batch is writing to"):
            batch(walks, tmp_path)
    finally:
        os.close(folder)


def test_an_output_that_is_a_file_is_refused(walks: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("x")
    with pytest.raises(OutputError, match="cannot write to folder"):
        batch(walks, tmp_path / "out")


def test_a_process_that_ends_before_its_request_is_a_crash(
    walks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(log: int) -> subprocess.Popen[bytes]:
        process = start(log)
        process.wait()
        return process

    start = execution._started
    monkeypatch.setattr(execution, "_PROGRAM", "raise SystemExit('no memory')")
    monkeypatch.setattr(execution, "_started", ended)
    result = run_job(Job("walk", str(walks / "walk0")), tmp_path, Limits(retries=0))
    assert (result.status, result.attempts) == (JobStatus.CRASHED, 1)
    assert "no memory" in (result.error or "")


def test_reports_are_made_where_they_are_missing(walks: Path, tmp_path: Path) -> None:
    batch(walks / "walk0", tmp_path)
    before = finished(tmp_path)
    assert not (tmp_path / "walk0" / "report.html").exists()
    batch(walks / "walk0", tmp_path, has_report=True)
    assert "<title>" in (tmp_path / "walk0" / "report.html").read_text()
    assert finished(tmp_path) == before
    assert 'href="walk0/report.html"' in (tmp_path / "index.html").read_text()
