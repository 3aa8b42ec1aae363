"""Poses as datagrams, with sockets of this machine."""

from __future__ import annotations

import json
import logging
import socket
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from pose_updates import estimate, keyframe, lost, update

from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import PredictedPose
from vo.outputs.streaming.sink import PoseRecords, encoded
from vo.outputs.streaming.streams import open_address


@pytest.fixture(params=["127.0.0.1", "::1"])
def receiver(request: pytest.FixtureRequest) -> Iterator[socket.socket]:
    family = socket.AF_INET6 if ":" in request.param else socket.AF_INET
    with closing(socket.socket(family, socket.SOCK_DGRAM)) as listening:
        try:
            listening.bind((request.param, 0))
        except OSError:
            pytest.skip("this machine has no IPv6")
        listening.settimeout(5.0)
        yield listening


def address_of(receiver: socket.socket) -> str:
    host, port, *_ = receiver.getsockname()
    return f"udp://[{host}]:{port}" if ":" in host else f"udp://{host}:{port}"


def test_every_frame_is_one_datagram(
    receiver: socket.socket, caplog: pytest.LogCaptureFixture
) -> None:
    with closing(open_address(address_of(receiver))) as sink:
        for frame in range(5):
            sink.send(update(frame))
    records = [json.loads(receiver.recv(65536)) for _ in range(5)]
    assert [record["frame"] for record in records] == list(range(5))
    assert caplog.records == []


def test_a_record_fits_into_a_packet_of_any_network() -> None:
    covariance = np.random.default_rng(0).uniform(-1e-7, -1e-8, (6, 6))
    known = replace(keyframe(123_456, 1.0), covariance=covariance)
    far = make_transform(so3_exp(np.array([-0.5, -0.6, -0.7])), np.full(3, -123_456.123_456_789))
    result = estimate(123_457, keyframes=(known,), world_from_cam0=far)
    assert 1000 < len(encoded(PoseRecords(is_metric=False).record(result))) < 1200


def test_a_predicted_record_fits_as_well() -> None:
    covariance = np.random.default_rng(0).uniform(-1e-7, -1e-8, (6, 6))
    known = replace(keyframe(123_456, 1.0), covariance=covariance)
    far = make_transform(so3_exp(np.array([-0.5, -0.6, -0.7])), np.full(3, -123_456.123_456_789))
    result = lost(123_457, keyframes=(known,), predicted=PredictedPose(far, covariance))
    assert 1000 < len(encoded(PoseRecords(is_metric=False).record(result))) < 1200


def test_a_name_means_ipv4_first() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(5.0)
        with closing(open_address(f"udp://localhost:{listening.getsockname()[1]}")) as sink:
            sink.send(update(7))
        assert json.loads(listening.recv(65536))["frame"] == 7


def test_what_does_not_arrive_is_counted(
    receiver: socket.socket, caplog: pytest.LogCaptureFixture
) -> None:
    address = address_of(receiver)
    host = receiver.getsockname()
    receiver.close()
    with closing(open_address(address)) as sink:
        for frame in range(10):
            sink.send(update(frame))
        with closing(socket.socket(receiver.family, socket.SOCK_DGRAM)) as late:
            late.bind(host)
            late.settimeout(5.0)
            for frame in range(10, 13):
                sink.send(update(frame))
            frames = [json.loads(late.recv(65536))["frame"] for _ in range(3)]
    assert frames == [10, 11, 12]
    assert caplog.messages == [
        f"{address}: poses do not arrive (Connection refused); the run goes on",
        f"{address}: at least 10 of 13 poses did not arrive (Connection refused)",
    ]
    assert {record.levelno for record in caplog.records} == {logging.WARNING}
