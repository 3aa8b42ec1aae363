"""Streaming to a running viewer, and failures of the viewer."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import fake_run
import pytest
from rerun.chunk import RrdReader
from rerun_cli import __main__ as rerun_cli

from vo.base.errors import OutputError
from vo.outputs.recorders import entities
from vo.outputs.recorders.rerun_recorder import RerunRecorder
from vo.outputs.recorders.viewer import check_viewer, start_web, viewer_url

VIEWER = Path(rerun_cli.__file__).with_name("rerun")
SCRIPT = """
import os, signal, sys, time; from pathlib import Path
import fake_run
from vo.outputs.recorders.background import BackgroundRecorder
from vo.outputs.recorders.rerun_recorder import RerunRecorder
path, url, pid = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
options = dict(queue_size=1000, may_drop=True, timeout_s=5.0)
recorder = BackgroundRecorder(RerunRecorder(path, viewer=url), **options)
recorder.begin('x', fake_run.RIG, None)
for frame in range(60):
    if frame == 20:
        time.sleep(0.5)
        os.kill(pid, getattr(signal, sys.argv[4]))
        time.sleep(0.5)
    fake_run.record(recorder, frame)
recorder.finish(fake_run.trajectory(), fake_run.trajectory())
print('the run continues')
"""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def viewer(tmp_path):
    """A viewer without a window that saves the received data; its process, URL and file."""
    port, saved = free_port(), tmp_path / "saved.rrd"
    command = [VIEWER, "--save", saved, "--port", str(port), "--bind", "127.0.0.1"]
    nothing = subprocess.DEVNULL
    with subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing) as process:
        url = viewer_url(str(port))
        give_up = time.monotonic() + 20
        while time.monotonic() < give_up:
            try:
                check_viewer(url)
                break
            except OutputError:
                time.sleep(0.1)
        yield process, url, saved
        process.kill()


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_a_viewer_receives_all_frames(viewer):
    _, url, saved = viewer
    recorder = RerunRecorder(None, viewer=url)
    recorder.begin("fake", fake_run.RIG, fake_run.trajectory())
    for frame in range(fake_run.FRAMES):
        fake_run.record(recorder, frame)
    recorder.finish(fake_run.trajectory(), fake_run.trajectory())
    give_up = time.monotonic() + 20
    rows = {}
    while rows.get(entities.LEFT_IMAGE) != fake_run.FRAMES and time.monotonic() < give_up:
        time.sleep(0.2)
        rows = {}
        for chunk in RrdReader(saved).stream().to_chunks():
            entity = chunk.entity_path.lstrip("/")
            rows[entity] = rows.get(entity, 0) + chunk.num_rows
    assert rows[entities.LEFT_IMAGE] == fake_run.FRAMES


@pytest.mark.parametrize("how", ["SIGKILL", "SIGSTOP"])
def test_run_and_file_continue_if_the_viewer_fails(viewer, tmp_path, how):
    process, url, _ = viewer
    path = tmp_path / "run.rrd"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent)])}
    command = [sys.executable, "-c", SCRIPT, path, url, str(process.pid), how]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60)
    process.send_signal(signal.SIGKILL)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "the run continues\n"
    warnings = [line for line in done.stderr.splitlines() if "stopped:" in line or "hangs" in line]
    assert len(warnings) == 1, done.stderr
    images = [
        chunk.num_rows
        for chunk in RrdReader(path).stream().to_chunks()
        if chunk.entity_path == f"/{entities.LEFT_IMAGE}"
    ]
    assert sum(images) == 60


@pytest.mark.parametrize(
    "typed, url",
    [
        ("9876", "rerun+http://127.0.0.1:9876/proxy"),
        ("robot:1234", "rerun+http://robot:1234/proxy"),
        ("robot", "rerun+http://robot:9876/proxy"),
        ("rerun+https://a.b:5/proxy", "rerun+https://a.b:5/proxy"),
    ],
)
def test_short_addresses_are_completed(typed, url):
    assert viewer_url(typed) == url


@pytest.mark.parametrize("typed", ["http://a:1", "a:b", "", "a:99999"])
def test_an_invalid_address_is_an_error(typed):
    with pytest.raises(OutputError, match="is not the address of a viewer; use HOST:PORT"):
        viewer_url(typed)


def test_a_missing_viewer_is_an_error():
    with pytest.raises(OutputError, match=r"no viewer answers at 127\.0\.0\.1:\d+ \(.+\)"):
        check_viewer(viewer_url(str(free_port())))


def test_another_server_at_the_address_is_an_error():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        threading.Thread(target=lambda: other.accept()[0].close(), daemon=True).start()
        with pytest.raises(OutputError, match="no viewer answers"):
            check_viewer(viewer_url(str(other.getsockname()[1])))


def test_a_served_viewer_answers_until_it_is_stopped():
    served = start_web()
    try:
        check_viewer(served.url)
        assert served.page.startswith("http://127.0.0.1:")
    finally:
        served.stop()
    with pytest.raises(OutputError):
        check_viewer(served.url)
