"""`vo run` as a command: output, exit status, and signals."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from run_calls import VO, summary_in, vo_run
from typer.testing import CliRunner

from vo.base.types import Trajectory
from vo.cli.app import app
from vo.recordings.formats.trajectory import read_tum, write_tum


def test_ends_with_a_table_and_the_next_command(synthetic_stereo: Path, out: Path) -> None:
    result = vo_run(synthetic_stereo, out, "--end", 5, "--config", "fast")
    assert result.exit_code == 0, result.output
    for words in ("(stereo, euroc)", "5 (100.0 %)", "keyframes", "frames/s", str(out)):
        assert words in result.stdout
    assert f"next: vo eval {out} {synthetic_stereo}" in result.stdout
    assert "\x1b" not in result.output
    assert "5 frames" in result.stderr
    assert "frame 1/5" in result.stderr


def test_the_next_command_works(synthetic_stereo: Path, out: Path) -> None:
    vo_run(synthetic_stereo, out, "--end", 5, "--config", "fast")
    result = CliRunner().invoke(app, ["eval", str(out), str(synthetic_stereo)])
    assert result.exit_code == 0, result.output


def test_quiet_prints_nothing(synthetic_stereo: Path, out: Path) -> None:
    result = vo_run(synthetic_stereo, out, "--end", 3, "--quiet")
    assert (result.exit_code, result.output) == (0, "")
    assert summary_in(out)["tracked"] == 3


def test_settings_come_from_file_and_flags(synthetic_stereo: Path, out: Path) -> None:
    own = out.with_name("own.yaml")
    own.write_text("features: {count: 700, levels: 4}\n", encoding="utf-8")
    flags = ("--config", own, "--set", "features.count=600", "--set", "seed=3", "--quiet")
    result = vo_run(synthetic_stereo, out, "--start", 2, "--end", 9, "--stride", 3, *flags)
    assert result.exit_code == 0, result.output
    text = (out / "config.yaml").read_text(encoding="utf-8")
    assert "count: 600" in text
    assert "levels: 4" in text
    summary = summary_in(out)
    assert (summary["seed"], summary["frames"]) == (3, 3)
    assert [summary[k] for k in ("start", "end", "stride")] == [2, 9, 3]


def test_mode_mono_uses_one_camera(synthetic_stereo: Path, out: Path) -> None:
    result = vo_run(synthetic_stereo, out, "--mode", "mono", "--end", 3)
    assert result.exit_code == 0, result.output
    assert summary_in(out)["mode"] == "mono"


def test_rrd_is_written_and_vo_view_suggested(synthetic_stereo: Path, out: Path) -> None:
    rrd = out / "run.rrd"
    result = vo_run(synthetic_stereo, out, "--end", 3, "--config", "fast", "--rrd", rrd)
    assert result.exit_code == 0, result.output
    assert f"next: vo view {rrd}" in result.stdout
    assert rrd.stat().st_size > 10_000


def test_a_run_on_noise_ends_with_a_warning(images: Path, out: Path) -> None:
    result = vo_run(images, out)
    assert result.exit_code == 3, result.output
    assert "warning: no frame was tracked" in result.stdout
    summary = summary_in(out)
    assert (summary["status"], summary["tracked"], summary["starting"]) == ("finished", 0, 5)


def test_help_contains_examples() -> None:
    result = CliRunner().invoke(app, ["run", "--help"])
    assert result.exit_code == 0
    assert "vo run my_sequence/ --output out/" in result.output


def test_the_whole_help_groups_the_options() -> None:
    lines = CliRunner().invoke(app, ["run", "--help-all"]).output.splitlines()
    heading = ""
    under: dict[str, str] = {}
    for line in lines:
        words = line.strip("╭╮│─* ").split()
        if line.startswith("╭"):
            heading = " ".join(words)
        elif words and words[0].startswith("--"):
            under[words[0]] = heading
    assert under["--calibration"] == under["--start"] == "Input"
    assert under["--output"] == under["--ply"] == "Output"
    assert [name for name, where in under.items() if where == "Options"] == [
        "--help-all",
        "--help",
    ]


def test_the_command_imports_nothing_heavy_before_it_runs() -> None:
    code = (
        "import sys, vo.cli.run; "
        "print([m for m in ('numpy', 'rich', 'cv2', 'gtsam', 'rerun') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() in ("[]", "['rich']")  # typer itself may use rich


# --- runs that end early -------------------------------------------------------------------------


def start_and_signal(source: Path, out: Path, number: signal.Signals) -> subprocess.Popen[str]:
    """Start a run, and send it a signal after three causal and three smoothed poses."""
    running = subprocess.Popen(
        [VO, "run", source, "--output", out, "--config", "fast"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    growing = [out / f"{name}.tum.partial" for name in ("causal", "trajectory")]
    give_up = time.monotonic() + 60
    while time.monotonic() < give_up and running.poll() is None:
        if all(path.exists() and path.read_bytes().count(b"\n") >= 3 for path in growing):
            break
        time.sleep(0.01)
    running.send_signal(number)
    return running


def test_ctrl_c_exits_130_with_one_line(synthetic_stereo: Path, out: Path) -> None:
    with start_and_signal(synthetic_stereo, out, signal.SIGINT) as running:
        stdout, stderr = running.communicate(timeout=60)
    assert running.returncode == 130, stderr
    assert stdout == ""
    assert stderr.splitlines()[-1].startswith("interrupted; ")
    assert "Traceback" not in stderr
    poses, summary = read_tum(out / "trajectory.tum"), summary_in(out)
    assert 3 <= len(poses) < 30
    assert (summary["status"], summary["tracked"]) == ("interrupted", len(poses))


def test_sigterm_ends_a_run_like_ctrl_c(synthetic_stereo: Path, out: Path) -> None:
    with start_and_signal(synthetic_stereo, out, signal.SIGTERM) as running:
        _, stderr = running.communicate(timeout=60)
    assert running.returncode == 128 + signal.SIGTERM, stderr
    assert stderr.splitlines()[-1] == f"interrupted; the results so far are in {out}"
    poses, summary = read_tum(out / "trajectory.tum"), summary_in(out)
    assert (summary["status"], summary["tracked"]) == ("interrupted", len(poses))


def test_a_run_stopped_before_the_first_frame_reports_no_results(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys\nfrom pathlib import Path\n"
        "from vo.cli.stopping import stop_signals_as_interrupts\n"
        "try:\n    with stop_signals_as_interrupts(Path(sys.argv[1])):\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "except BaseException as error: print(error.exit_code)\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "143\n"
    assert done.stderr == "interrupted before the first frame; nothing was written\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no /dev/full")
def test_a_run_survives_a_full_standard_error(synthetic_stereo: Path, out: Path) -> None:
    with Path("/dev/full").open("w") as full:
        command = [VO, "run", synthetic_stereo, "-o", out, "--end", "3", "--config", "fast"]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=full, text=True)
    assert done.returncode == 0
    assert "all 3 frames have a pose" in done.stdout


def test_prints_with_an_ascii_locale() -> None:
    env = {**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    done = subprocess.run([VO, "synth", "--list"], capture_output=True, text=True, env=env)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_killed_run_can_still_be_evaluated(synthetic_stereo: Path, out: Path) -> None:
    with start_and_signal(synthetic_stereo, out, signal.SIGKILL) as running:
        running.communicate(timeout=60)
    assert running.returncode == -signal.SIGKILL
    assert summary_in(out)["status"] == "interrupted"
    assert len(read_tum(out / "causal.tum.partial")) >= 3
    result = CliRunner().invoke(app, ["eval", str(out), str(synthetic_stereo)])
    assert result.exit_code == 0, result.output


def test_a_bug_keeps_its_traceback(
    images: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("vo.engine.odometry.Odometry._process", broken)
    assert isinstance(vo_run(images, out).exception, ZeroDivisionError)


def test_a_terminal_shows_a_progress_bar(synthetic_stereo: Path, out: Path) -> None:
    pty = pytest.importorskip("pty")
    parent, child = pty.openpty()
    command = [VO, "run", synthetic_stereo, "-o", out, "--end", "4", "--config", "fast"]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=child, env=environment) as run:
        os.close(child)
        shown = b""
        while True:
            try:
                data = os.read(parent, 4096)
            except OSError:  # how Linux reports that the other end is closed
                break
            if not data:
                break
            shown += data
    os.close(parent)
    assert run.returncode == 0
    assert "getting ready" in shown.decode()
    assert "frames/s" in shown.decode()


def test_prints_its_version() -> None:
    from vo import __version__

    result = CliRunner().invoke(app, ["--version"])
    assert (result.exit_code, result.stdout) == (0, f"vo {__version__}\n")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no /dev/full")
def test_output_on_a_full_disk_is_one_line_of_error(tmp_path: Path) -> None:
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = np.arange(5)
    path = tmp_path / "path.tum"
    write_tum(path, Trajectory(np.arange(5, dtype=np.int64) * 10**8, poses))
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [VO, "eval", path, path], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert (done.returncode, done.stderr) == (
        1,
        "error: standard output: No space left on device\n",
    )


def test_next_commands_can_be_run(synthetic_stereo: Path, out: Path) -> None:
    """Each as printed: the second run is the same as the first, and is recorded."""
    options = ("--mode", "mono", "--start", 2, "--end", 12, "--stride", 2, "--config", "fast")
    more = ("--set", "features.count=700", "--no-loops", "--no-imu", "--ignore", "0,0,9,9")
    result = vo_run(synthetic_stereo, out, *options, *more)
    first = (out / "trajectory.tum").read_text()
    commands = [
        shlex.split(line.removeprefix("next: vo "))
        for line in result.stdout.splitlines()
        if line.startswith("next: ")
    ]
    assert [command[0] for command in commands] == ["eval", "report", "run"]
    for command in commands[::-1]:
        done = CliRunner().invoke(app, command)
        assert done.exit_code == 0, done.output
    assert (out / "trajectory.tum").read_text() == first
    assert (out / "run.rrd").exists()
    assert summary_in(out)["frames"] == 5
