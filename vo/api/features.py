"""Features by name (`vo.features`); `create` is the public interface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vo.api.features_by_name import Features

__all__ = ["create"]


def create(name: str, **settings: Any) -> Features:
    """A detector with its descriptor, such as `create("sift", count=2000)`.

    Args:
        name: `orb`, `sift`, `fast`, ...: any value of the setting `features.detector`.
        **settings: other settings of the section `features`: count, descriptor, selection, ...

    Raises:
        ConfigError: a name or setting is unknown or invalid, or this build of OpenCV lacks it.
    """
    from vo.api.features_by_name import features_by_name

    return features_by_name(name, settings)
