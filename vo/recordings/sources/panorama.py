"""Equirectangular images that say of themselves what they are.

Source: Google, "Spherical Video V1" and "V2" RFCs, and "Photo Sphere XMP Metadata".
"""

from __future__ import annotations

import re
from pathlib import Path

from vo.recordings.formats.mp4_boxes import child_boxes, read_mp4
from vo.recordings.sources.images import ImageFile, StoredImage
from vo.recordings.sources.orientation import HEADER_BYTES

_UUID = bytes.fromhex("ffcc8263f8554a938814587a02521fdd")
_SAMPLE_ENTRY = 16 + 78  # bytes of `stsd` before the boxes in its first entry, of a video
_IS_EQUIRECTANGULAR = re.compile(rb'ProjectionType\s*(=\s*"|>)\s*equirectangular', re.IGNORECASE)
_STEREO = re.compile(rb'StereoMode\s*(=\s*"|>)\s*(top|left)', re.IGNORECASE)


def is_panorama(film: Path | None, first: StoredImage, size: tuple[int, int]) -> bool:
    """Whether a film, or the first image, of a size (width, height) is marked as equirectangular.

    Those of two eyes, and parts of a sphere, are not.
    """
    if size[0] != 2 * size[1]:
        return False
    if isinstance(first, ImageFile):
        try:
            with first.path.open("rb") as file:
                return _is_marked(file.read(HEADER_BYTES))
        except OSError:
            return False
    return film is not None and any(_is_spherical(t.tables) for t in read_mp4(film).tracks)


def _is_marked(text: bytes) -> bool:
    return bool(_IS_EQUIRECTANGULAR.search(text)) and not _STEREO.search(text)


def _is_spherical(tables: dict[bytes, bytes]) -> bool:
    marked = tables.get(b"uuid", b"")
    if marked.startswith(_UUID):
        return _is_marked(marked)
    entry = dict(child_boxes(tables.get(b"stsd", b"")[_SAMPLE_ENTRY:]))
    if entry.get(b"st3d", b"\0" * 5)[4:5] != b"\0":
        return False
    projection = dict(child_boxes(dict(child_boxes(entry.get(b"sv3d", b""))).get(b"proj", b"")))
    bounds = projection.get(b"equi", b"x")[4:]
    return len(bounds) == 16 and not any(bounds)
