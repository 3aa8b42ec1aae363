"""Parser of ROS's camera_info as INI, written by `camera_calibration` (ost.txt) and by drivers.

Names stand on lines of their own, followed by lines of numbers:

    [image]
    width
    640

    [narrow_stereo/left]
    camera matrix
    500.1 0.0 320.5
    0.0 500.9 239.0
    0.0 0.0 1.0
"""

from __future__ import annotations

import re

_FIELDS = {
    "width": "width",
    "height": "height",
    "camera matrix": "k",
    "distortion": "d",
    "rectification": "r",
    "projection": "p",
}
_CAMERA_MATRIX = re.compile(r"^[ \t]*camera matrix[ \t]*$", re.MULTILINE)


def is_ini(text: str) -> bool:
    """Whether the text has a line `camera matrix`."""
    return _CAMERA_MATRIX.search(text) is not None


def fields_of(text: str) -> dict[str, object]:
    """Fields of the message camera_info, unchecked: width, height, and lists d, k, r and p."""
    words: dict[str, list[str]] = {}
    current: list[str] | None = None
    for line in text.splitlines():
        name = " ".join(line.split()).lower()
        if not name or name.startswith(("#", ";")):
            continue
        if name.startswith("["):
            current = None
        elif name in _FIELDS:
            current = words.setdefault(_FIELDS[name], [])
        elif name[0].isalpha() and name.split()[0] not in ("nan", "inf"):
            current = None  # a field that is not needed, such as `translation`
        elif current is not None:
            current += line.split()
    return {
        name: listed[0] if name in ("width", "height") and len(listed) == 1 else listed
        for name, listed in words.items()
    }
