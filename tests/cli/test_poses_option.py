"""`vo run --poses`: what a program at the other end gets, and how the run ends with it."""

from __future__ import annotations

import json
import os
import shlex
import signal
import socket
import subprocess
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from run_calls import VO, summary_in, vo_run

from vo.outputs.streaming.sink import SCHEMA_FILE
from vo.recordings.formats.trajectory import read_tum

FRAMES = 12
FAST = ("--config", "fast")


def lines_in(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def run_in_shell(source: Path, out: Path, rest: str) -> subprocess.CompletedProcess[str]:
    """Run `vo run SOURCE -o OUT --config fast REST` in a shell with pipefail."""
    words = [VO, "run", source, "-o", out, *FAST]
    command = f"set -o pipefail; {shlex.join(map(str, words))} {rest}"
    return subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, timeout=120, check=False
    )


def test_standard_output_is_a_record_for_each_frame_and_nothing_else(
    synthetic_stereo: Path, out: Path
) -> None:
    done = run_in_shell(synthetic_stereo, out, f"--end {FRAMES} --poses -")
    assert done.returncode == 0, done.stderr
    records = lines_in(done.stdout)
    assert [record["frame"] for record in records] == list(range(FRAMES))
    validator = pytest.importorskip("jsonschema").Draft202012Validator(
        json.loads(SCHEMA_FILE.read_text(encoding="utf-8"))
    )
    for record in records:
        validator.validate(record)
    assert "all 12 frames have a pose" in done.stderr
    assert "next: vo report" in done.stderr


def test_poses_have_the_digits_of_causal_tum(synthetic_stereo: Path, out: Path) -> None:
    result = vo_run(synthetic_stereo, out, "--end", FRAMES, *FAST, "--poses", "-", "-q")
    assert (result.exit_code, result.stderr) == (0, "")
    records = lines_in(result.stdout)
    lines = (out / "causal.tum").read_text(encoding="utf-8").splitlines()
    assert len(lines) == len(records) == FRAMES
    for record, line in zip(records, lines, strict=True):
        pose = record["world_from_cam0"]
        assert [float(field) for field in line.split()[1:]] == [
            *pose["position_xyz"],
            *pose["quat_xyzw"],
        ]
    stamps_ns = read_tum(out / "causal.tum").stamps_ns.tolist()
    assert [record["stamp_ns"] for record in records] == stamps_ns
    keyframes = sum(record["is_keyframe"] for record in records)
    assert keyframes == summary_in(out)["keyframes"]
    assert records[-1]["covariance"]["keyframe"] > 0


def test_frames_without_a_pose_say_why(images: Path, out: Path) -> None:
    result = vo_run(images, out, "--poses", "-", "-q")
    records = lines_in(result.stdout)
    assert [record["state"] for record in records] == ["starting"] * 5
    assert {record["world_from_cam0"] for record in records} == {None}
    assert records[0]["failure"] is not None
    assert {record["length_unit"] for record in records} == {"map units"}


def test_a_reader_that_ends_early_ends_the_run_with_its_results(
    synthetic_stereo: Path, out: Path
) -> None:
    done = run_in_shell(synthetic_stereo, out, "--poses - | head -n 3")
    assert done.returncode == 128 + signal.SIGPIPE
    assert [record["frame"] for record in lines_in(done.stdout)] == [0, 1, 2]
    last = done.stderr.splitlines()[-1]
    assert last == f"nothing reads the poses any more; the results so far are in {out}"
    assert "Traceback" not in done.stderr
    assert "Error" not in done.stderr
    summary = summary_in(out)
    assert summary["status"] == "interrupted"
    assert 3 <= summary["frames"] < 30
    assert len(read_tum(out / "causal.tum")) == summary["tracked"] == summary["frames"]


def test_a_reader_that_is_gone_at_the_last_frame_changes_nothing(
    synthetic_stereo: Path, out: Path
) -> None:
    done = run_in_shell(synthetic_stereo, out, "--end 1 --poses - | true")
    assert done.returncode == 0, done.stderr
    assert summary_in(out)["status"] == "finished"


def test_a_run_whose_reader_stands_still_can_be_stopped(synthetic_stereo: Path, out: Path) -> None:
    with subprocess.Popen(
        [VO, "run", synthetic_stereo, "-o", out, *FAST, "--poses", "-"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        pipesize=4096,
    ) as running:
        frames = out / "frames.csv.partial"
        give_up = time.monotonic() + 60
        counts = [-1, -2]
        while time.monotonic() < give_up and not (counts[-1] == counts[-2] > 2):
            time.sleep(1.0)  # until no frame is added any more: the pipe is full
            counts.append(frames.read_bytes().count(b"\n") if frames.exists() else -1)
        assert counts[-1] < 20
        running.send_signal(signal.SIGTERM)
        assert running.wait(timeout=30) == 128 + signal.SIGTERM
    summary = summary_in(out)
    assert summary["status"] == "interrupted"
    assert len(read_tum(out / "causal.tum")) == summary["tracked"] >= 2


def test_a_full_disk_costs_the_poses_and_not_the_run(synthetic_stereo: Path, out: Path) -> None:
    done = run_in_shell(synthetic_stereo, out, "--end 4 -q --poses - > /dev/full")
    assert done.returncode == 0
    assert done.stderr == (
        "warning: standard output: no more poses are written: No space left on device\n"
    )
    assert summary_in(out)["status"] == "finished"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--poses - >&-", "error: standard output is closed; --poses - needs it\n"),
        ("--poses - --poses -", "error: standard output is given twice for poses; leave one out\n"),
        (
            "--poses poses.jsonl",
            "error: poses.jsonl is no address for poses; "
            "write -, udp://HOST:PORT or ws://HOST:PORT\n",
        ),
    ],
)
def test_what_cannot_be_done_is_refused_before_the_run(
    synthetic_stereo: Path, out: Path, arguments: str, message: str
) -> None:
    done = run_in_shell(synthetic_stereo, out, arguments)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", message)
    assert not out.exists()


def test_an_unknown_host_and_a_taken_port_are_refused_before_the_run(
    synthetic_stereo: Path, out: Path
) -> None:
    unknown = vo_run(synthetic_stereo, out, "--poses", "udp://no.such.host.invalid:9000")
    assert unknown.exit_code == 1
    assert unknown.stderr.startswith("error: udp://no.such.host.invalid:9000: ")
    assert unknown.stderr.count("\n") == 1
    pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        address = f"ws://:{other.getsockname()[1]}"
        taken = vo_run(synthetic_stereo, out, "--poses", address)
    assert taken.exit_code == 1
    assert taken.stderr.startswith(f"error: {address}: ")
    assert taken.stderr.count("\n") == 1
    assert not out.exists()


def test_datagrams_and_lines_at_once(synthetic_stereo: Path, out: Path) -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        address = f"udp://127.0.0.1:{receiver.getsockname()[1]}"
        options = ("--end", 4, "-q", *FAST, "--poses", address, "--poses", "-")
        result = vo_run(synthetic_stereo, out, *options)
        datagrams = [receiver.recv(65536).decode() for _ in range(4)]
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.splitlines() == datagrams


def test_where_foxglove_can_connect_is_said(synthetic_stereo: Path, out: Path) -> None:
    pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
    result = vo_run(synthetic_stereo, out, "--end", 2, *FAST, "--poses", "ws://:0")
    assert result.exit_code == 0, result.output
    assert "poses for Foxglove at ws://127.0.0.1:" in result.stderr
    quiet = vo_run(synthetic_stereo, out, "--end", 2, *FAST, "--poses", "ws://:0", "-q")
    assert (quiet.exit_code, quiet.output) == (0, "")


def test_the_path_is_the_same_with_and_without(synthetic_stereo: Path, tmp_path: Path) -> None:
    for name, options in (("with", ("--poses", "-")), ("without", ())):
        vo_run(synthetic_stereo, tmp_path / name, "--end", FRAMES, *FAST, *options)
    for name in ("trajectory.tum", "causal.tum", "covariance.csv"):
        assert (tmp_path / "with" / name).read_bytes() == (tmp_path / "without" / name).read_bytes()


def test_a_terminal_shows_the_poses_without_a_progress_bar(
    synthetic_stereo: Path, out: Path
) -> None:
    master, terminal = os.openpty()
    command = [VO, "run", synthetic_stereo, "-o", out, "--end", "3", *FAST, "--poses", "-"]
    with subprocess.Popen(command, stdout=terminal, stderr=subprocess.PIPE, text=True) as running:
        _, errors = running.communicate(timeout=60)
    os.close(terminal)
    shown = os.read(master, 1 << 16).decode()
    os.close(master)
    assert [record["frame"] for record in lines_in(shown)] == [0, 1, 2]
    assert "frame 1/3" not in errors
    assert "all 3 frames have a pose" in errors
