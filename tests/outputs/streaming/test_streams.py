"""Several outputs of poses: each goes on without the others, and addresses are checked."""

from __future__ import annotations

import errno
import io
import json
import logging
import os
import signal
import threading
import time
from contextlib import suppress

import pytest
from pose_updates import estimate, update

from vo.base.errors import OutputError
from vo.outputs.streaming.json_lines import JsonLines
from vo.outputs.streaming.sink import PoseUpdate
from vo.outputs.streaming.streams import PoseStreams, opened_streams


class Failing:
    """An output that raises an error from a frame on."""

    def __init__(self, error: BaseException, at: int = 1) -> None:
        self.name = "a made-up output"
        self.frames: list[int] = []
        self.is_closed = False
        self._error, self._at = error, at

    def send(self, update: PoseUpdate) -> None:
        self.frames.append(update.estimate.frame_index)
        if update.estimate.frame_index >= self._at:
            raise self._error

    def close(self) -> None:
        self.is_closed = True


def frames_in(file: io.BytesIO) -> list[int]:
    return [json.loads(line)["frame"] for line in file.getvalue().splitlines()]


def run(streams: PoseStreams, frames: int = 4) -> None:
    streams.begin(is_metric=True)
    for frame in range(frames):
        streams.send(estimate(frame))


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_one_that_fails_is_left_out_with_a_line(
    error: Exception, reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    failing, file = Failing(error), io.BytesIO()
    with opened_streams([failing, JsonLines(file)]) as streams:
        run(streams)
        streams.check()
    assert (failing.frames, failing.is_closed) == ([0, 1], True)
    assert frames_in(file) == [0, 1, 2, 3]
    assert caplog.messages == [f"a made-up output: no more poses are written: {reason}"]


@pytest.mark.parametrize(
    ("error", "number"),
    [(BrokenPipeError(), signal.SIGPIPE), (KeyboardInterrupt(signal.SIGTERM), signal.SIGTERM)],
)
def test_a_reader_that_is_gone_ends_the_run_after_the_frame(
    error: BaseException, number: int, caplog: pytest.LogCaptureFixture
) -> None:
    failing, file = Failing(error), io.BytesIO()
    with opened_streams([failing, JsonLines(file)]) as streams:
        run(streams, 2)
        assert frames_in(file) == [0, 1]
        with pytest.raises(KeyboardInterrupt) as stop:
            streams.check()
    assert stop.value.args == (number,)
    assert caplog.records == []


def test_a_file_that_takes_parts_of_a_line_gets_all_of_it() -> None:
    class Narrow(io.BytesIO):
        def write(self, data: memoryview) -> int:  # type: ignore[override]
            return super().write(data[:7])

    file = Narrow()
    JsonLines(file).send(update(3))
    assert file.getvalue() == update(3).record + b"\n"


def test_a_full_pipe_that_does_not_block_gets_every_line() -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    received = []

    def read() -> None:
        while part := os.read(reading, 4096):
            received.append(part)

    with open(writing, "wb", buffering=0) as file:
        sink = JsonLines(file)
        sink.send(update(0))
        with suppress(BlockingIOError):
            while os.write(writing, b"\n" * 4096):
                pass
        reader = threading.Thread(target=read)
        threading.Timer(0.2, reader.start).start()
        for frame in range(1, 200):
            sink.send(update(frame))
    while not reader.ident:
        time.sleep(0.01)
    reader.join()
    os.close(reading)
    lines = [json.loads(line) for line in b"".join(received).splitlines() if line]
    assert [line["frame"] for line in lines] == list(range(200))


def test_a_live_source_does_not_wait_for_a_reader(caplog: pytest.LogCaptureFixture) -> None:
    reading, writing = os.pipe()
    frames = 400
    with open(writing, "wb", buffering=0) as file, opened_streams([JsonLines(file)]) as streams:
        streams.begin(is_metric=True, is_live=True)
        for frame in range(frames):
            streams.send(estimate(frame))
        with open(reading, "rb", buffering=0, closefd=False) as pipe:
            early = pipe.read(1 << 20).splitlines()
        streams.send(estimate(frames))
        streams.check()
    (late,) = os.read(reading, 1 << 20).splitlines()
    os.close(reading)
    written = [json.loads(line)["frame"] for line in early]
    assert written == list(range(len(written)))
    assert 10 < len(written) < frames
    assert json.loads(late)["frame"] == frames
    assert caplog.messages == [
        "standard output: poses are left out, as they are read too slowly",
        f"standard output: {frames - len(written)} poses were left out",
    ]


def test_without_outputs_nothing_is_made() -> None:
    streams = PoseStreams()
    streams.send(estimate(0))
    streams.check()


@pytest.mark.parametrize(
    ("address", "complaint"),
    [
        ("poses.jsonl", "write -, udp://HOST:PORT or ws://HOST:PORT"),
        ("tcp://localhost:5", "write -, udp://HOST:PORT or ws://HOST:PORT"),
        ("wss://localhost:5", "write -, udp://HOST:PORT or ws://HOST:PORT"),
        ("localhost:5000", "write -, udp://HOST:PORT or ws://HOST:PORT"),
        ("udp:localhost:5", "write -, udp://HOST:PORT or ws://HOST:PORT"),
        ("udp://localhost", "host or port is missing"),
        ("udp://:5000", "host or port is missing"),
        ("udp://localhost:0", "host or port is missing"),
        ("udp://localhost:70000", "Port out of range"),
        ("udp://localhost:port", "no address for poses"),
        ("udp://[::1:5000", "no address for poses"),
        ("udp://me@localhost:5000", "more than an address"),
        ("ws://localhost:5000/path", "no address for poses"),
        ("ws://localhost:5000?a=b", "more than an address"),
        ("udp://no.such.host.invalid:5000", "udp://no.such.host.invalid:5000: "),
        (f"udp://{'a' * 300}:5000", "write udp://HOST:PORT"),
    ],
)
def test_an_address_that_cannot_be_used_is_refused(address: str, complaint: str) -> None:
    with pytest.raises(OutputError) as refusal, opened_streams([address]):
        pass
    assert complaint in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_an_output_given_twice_is_refused_and_the_first_is_closed() -> None:
    failing = Failing(OSError())
    with (
        pytest.raises(OutputError, match="a made-up output is given twice"),
        opened_streams([failing, failing]),
    ):
        pass
    assert failing.is_closed


def test_logging_is_at_the_usual_level() -> None:
    assert logging.getLogger("vo.outputs.streaming").level == logging.NOTSET
