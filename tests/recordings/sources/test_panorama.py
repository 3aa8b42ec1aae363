"""360° images and films without calibration, known by what is written in them."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from vo.base.errors import CalibrationError
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.panorama import is_panorama
from vo.recordings.sources.registry import open_source

XMP = (
    b"http://ns.adobe.com/xap/1.0/\0<rdf:Description "
    b'GPano:ProjectionType="equirectangular" GPano:UsePanoramaViewer="True"/>'
)
V1 = b"<rdf:SphericalVideo><GSpherical:Spherical>true</GSpherical:Spherical>" + (
    b"<GSpherical:ProjectionType>equirectangular</GSpherical:ProjectionType>"
)
UUID = bytes.fromhex("ffcc8263f8554a938814587a02521fdd")


def box(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I4s", 8 + len(body), kind) + body


def film(path: Path, *, uuid: bytes = b"", bounds: int = 0, eyes: int | None = None) -> Path:
    """A film with one track, without images."""
    equi = box(b"equi", struct.pack(">5I", 0, bounds, 0, 0, 0))
    spherical = b"" if uuid else box(b"sv3d", box(b"proj", box(b"prhd", bytes(16)) + equi))
    stereo = b"" if eyes is None else box(b"st3d", bytes([0, 0, 0, 0, eyes]))
    entry = box(b"avc1", bytes(78) + stereo + spherical)
    tables = box(b"stbl", box(b"stsd", struct.pack(">II", 0, 1) + entry))
    track = box(b"mdia", box(b"minf", tables)) + (box(b"uuid", uuid) if uuid else b"")
    path.write_bytes(box(b"moov", box(b"trak", track)))
    return path


def photograph(path: Path, marking: bytes, size: tuple[int, int]) -> ImageFile:
    """A JPEG with XMP."""
    noise = np.random.default_rng(1).integers(0, 255, size[::-1]).astype(np.uint8)
    data = cv2.imencode(".jpg", noise)[1].tobytes()
    marked = b"\xff\xe1" + struct.pack(">H", 2 + len(marking)) + marking if marking else b""
    path.write_bytes(data[:2] + marked + data[2:])
    return ImageFile(path)


def test_films_of_both_versions_are_known(tmp_path: Path) -> None:
    image = ImageFile(tmp_path / "none.png")
    first = object()
    for number, (given, expected) in enumerate(
        [
            ({}, True),
            ({"eyes": 0}, True),
            ({"eyes": 2}, False),
            ({"bounds": 7}, False),
            ({"uuid": UUID + V1}, True),
            ({"uuid": UUID + V1 + b"<GSpherical:StereoMode>top-bottom<"}, False),
            ({"uuid": bytes(16) + V1}, False),
        ]
    ):
        path = film(tmp_path / f"{number}.mp4", **given)  # type: ignore[arg-type]
        assert is_panorama(path, first, (1024, 512)) is expected, given  # type: ignore[arg-type]
        assert not is_panorama(path, first, (1024, 576))  # type: ignore[arg-type]
    assert not is_panorama(None, image, (1024, 512))


@pytest.mark.parametrize(("marking", "width"), [(XMP, 256), (b"", 256), (XMP, 200)])
def test_a_folder_of_marked_photographs_is_opened(
    tmp_path: Path, marking: bytes, width: int
) -> None:
    for number in range(4):
        photograph(tmp_path / f"{number:04d}.jpg", marking, (width, 128))
    if not marking or width != 256:
        with pytest.raises(CalibrationError, match="no calibration found"):
            open_source(tmp_path)
        return
    camera = open_source(tmp_path).rig.cam0
    assert camera.distortion_model == "equirectangular"
    assert (camera.width, camera.height) == (256, 128)
