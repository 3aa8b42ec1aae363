"""The kinds of calibration file, told apart by what they contain."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from vo.errors import CalibrationError
from vo.formats.calibration import euroc, kalibr, kitti, own
from vo.formats.calibration.document import Calibration, Document, ImageSize, load_document


class CalibrationFormat(NamedTuple):
    """A kind of file: how to know it, and how to read it given the size of the images."""

    recognises: Callable[[Document], bool]
    read: Callable[[Document, ImageSize | None], Calibration]


FORMATS: dict[str, CalibrationFormat] = {
    "kitti": CalibrationFormat(kitti.recognises, kitti.read),
    "kalibr": CalibrationFormat(kalibr.recognises, kalibr.read),
    "euroc": CalibrationFormat(euroc.recognises, euroc.read),
    "vo": CalibrationFormat(own.recognises, own.read),
}


def read_calibration(path: Path | str, image_size: ImageSize | None = None) -> Calibration:
    """Read a calibration file of any known kind.

    Args:
        path: the file.
        image_size: width and height of the images, for kinds that do not give them (KITTI).

    Raises:
        CalibrationError: the file is missing, of no known kind, or what it says cannot be true.
    """
    document = load_document(Path(path))
    for kind in FORMATS.values():
        if kind.recognises(document):
            return kind.read(document, image_size)
    raise CalibrationError(
        f"{path} is no calibration file of a known kind ({', '.join(FORMATS)}); "
        "docs/calibration.md shows what one looks like"
    )
