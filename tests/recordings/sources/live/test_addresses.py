"""Addresses of live sources, and what is printed of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from vo.base.errors import SourceError
from vo.recordings.sources.live.address import LiveKind, parse_address, without_credentials
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.uncalibrated import open_uncalibrated


@pytest.mark.parametrize(
    ("text", "kind", "targets"),
    [
        ("camera:0", LiveKind.CAMERA, ("0",)),
        ("camera:0,2", LiveKind.CAMERA, ("0", "2")),
        ("camera:/dev/video1", LiveKind.CAMERA, ("/dev/video1",)),
        ("/dev/video0", LiveKind.CAMERA, ("/dev/video0",)),
        ("/dev/video0,/dev/video2", LiveKind.CAMERA, ("/dev/video0", "/dev/video2")),
        (
            "/dev/v4l/by-id/usb-A_B-video-index0,/dev/video2",
            LiveKind.CAMERA,
            ("/dev/v4l/by-id/usb-A_B-video-index0", "/dev/video2"),
        ),
        ("rtsp://host:554/a,b", LiveKind.NETWORK, ("rtsp://host:554/a,b",)),
        ("rtsp://host/l,rtsp://host/r", LiveKind.NETWORK, ("rtsp://host/l", "rtsp://host/r")),
        ("HTTP://host/video.mjpg", LiveKind.NETWORK, ("HTTP://host/video.mjpg",)),
        ("realsense:", LiveKind.REALSENSE, ()),
        ("oak:1844301", LiveKind.OAK, ("1844301",)),
        ("zed:", LiveKind.ZED, ()),
    ],
)
def test_an_address_names_a_kind_and_one_or_two_targets(
    text: str, kind: LiveKind, targets: tuple[str, ...]
) -> None:
    address = parse_address(text)
    assert address is not None
    assert (address.kind, address.targets) == (kind, targets)


@pytest.mark.parametrize("text", ["clips/walk", "camera", "/dev/null", "a:b", "C:/clips", "-", ""])
def test_paths_are_no_addresses(text: str) -> None:
    assert parse_address(text) is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("camera:", "camera '' is neither a number nor a device file; use camera:0"),
        ("camera:left", "camera 'left' is neither"),
        ("camera:0,1,2", "camera:0,1,2 names 3 cameras"),
        ("camera:²", "neither a number"),
        ("rtsp://a/b,/dev/video0", "a pair is two URLs"),
    ],
)
def test_what_is_no_camera_is_refused(text: str, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        parse_address(text)


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("rtsp://host/path", "rtsp://host/path"),
        ("rtsp://me:pass@host/path", "rtsp://me:***@host/path"),
        ("rtsp://me:p@ss@host:554/path", "rtsp://me:***@host:554/path"),
        ("rtsp://me:a/b@host/path", "rtsp://me:***@host/path"),
        ("http://token@host/path", "http://***@host/path"),
        ("http://host/v?user=me&password=abc&n=1", "http://host/v?user=me&password=***&n=1"),
        ("http://host/v?access_token=abc", "http://host/v?access_token=***"),
        ("rtsp://a:b@l/1,rtsp://a:c@r/2", "rtsp://a:***@l/1,rtsp://a:***@r/2"),
    ],
)
def test_passwords_are_not_shown(url: str, shown: str) -> None:
    assert without_credentials(f"Connection to {url} failed") == f"Connection to {shown} failed"
    address = parse_address(url)
    assert address is not None
    assert address.public_name == shown


@pytest.mark.parametrize(
    ("path", "shown"),
    [("camera:0", "camera:0"), ("rtsp://me:secret@host/x", "rtsp://me:***@host/x")],
)
def test_what_reads_recordings_says_that_a_source_is_live(path: str, shown: str) -> None:
    for open_it in (open_source, open_uncalibrated):
        with pytest.raises(SourceError) as told:
            open_it(Path(path))
        assert str(told.value).startswith(f"{shown} is live: `vo run` reads it")
