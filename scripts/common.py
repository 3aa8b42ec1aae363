"""What several scripts share: sections of pages, and the calibration of a recording of TUM."""

from __future__ import annotations

from pathlib import Path

_TUM_CALIBRATION = """\
cam0:
  resolution: [640, 480]
  intrinsics: [535.4, 539.2, 320.1, 247.6]
"""


def write_tum_calibration(folder: Path) -> Path:
    """Write the calibration of the recordings of fr3; its path."""
    path = folder / "tum.yaml"
    path.write_text(_TUM_CALIBRATION, encoding="utf-8")
    return path


def write_section(page: Path, section: str, text: str) -> None:
    """Write new text between the marks of a section of a page."""
    begin, end = f"<!-- {section}: begin -->", f"<!-- {section}: end -->"
    before, rest = page.read_text(encoding="utf-8").split(begin)
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{rest.split(end)[1]}", encoding="utf-8")
