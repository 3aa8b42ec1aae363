"""What this build of OpenCV has: its functions by name, and which package brings a missing one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import cv2

from vo.base.errors import ConfigError

_CONTRIB = "opencv-contrib-python-headless"
_PATENTED = frozenset({"SURF"})


def find(name: str) -> Callable[..., Any] | None:
    """A function of OpenCV, from the main modules or from xfeatures2d, None if it is in neither."""
    for module in (cv2, getattr(cv2, "xfeatures2d", None)):
        function = getattr(module, name, None)
        if function is not None:
            return function  # type: ignore[no-any-return]
    return None


def has_algorithm(name: str) -> bool:
    """Whether an algorithm, such as `AKAZE`, can be created here."""
    create = find(f"{name}_create")
    if create is None or name not in _PATENTED:
        return create is not None
    try:
        create()
    except cv2.error:
        return False
    return True


def require_algorithm(name: str, word: str) -> Callable[..., Any]:
    """The function that creates an algorithm such as `AKAZE`; `word` names it in errors.

    Raises:
        ConfigError: this build does not have it.
    """
    create = find(f"{name}_create")
    if create is not None and has_algorithm(name):
        return create
    if name in _PATENTED:
        raise ConfigError(
            f"{word} is patented and in no package of OpenCV; it needs a build of your own with "
            "OPENCV_ENABLE_NONFREE"
        )
    raise ConfigError(_missing(word))


def require_function(name: str, word: str) -> Callable[..., Any]:
    """A function of OpenCV.

    Raises:
        ConfigError: this build does not have it.
    """
    function = find(name)
    if function is None:
        raise ConfigError(_missing(word))
    return function


def describe_missing(algorithms: Mapping[str, str]) -> str:
    """Names of missing algorithms in one line, with what brings them; a name for each algorithm."""
    patented = [name for name, algorithm in algorithms.items() if algorithm in _PATENTED]
    others = [name for name in algorithms if name not in patented]
    parts = [f"{', '.join(others)} ({_CONTRIB} has them)"] if others else []
    parts += [f"{name} (patented, in no package)" for name in patented]
    return ", ".join(parts)


def _missing(word: str) -> str:
    return (
        f"{word} is not in this build of OpenCV; {_CONTRIB} has it: pip uninstall "
        f"opencv-python-headless, then pip install {_CONTRIB}"
    )
