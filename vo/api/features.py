"""Features by name (`vo.features`): `create` one, `compare` many."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

if TYPE_CHECKING:
    from vo.api.features_by_name import Features
    from vo.tools.laboratory.comparison import Comparison
    from vo.tools.laboratory.methods import Method
    from vo.tools.laboratory.repeatability import PlaneScore

__all__ = ["compare", "compare_planes", "create"]


class ReadingWords(TypedDict, total=False):
    """How a recording is read: its format, another calibration, the image topics of a log."""

    format: str | None
    calibration: str | Path | None
    topics: Sequence[str]


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


def compare(
    recording: str | Path,
    methods: str | Sequence[str],
    *,
    gaps: Sequence[int] = (1, 5, 15, 30),
    pairs: int = 8,
    overrides: Sequence[str] = (),
    picture: str | Path | None = None,
    **reading: Unpack[ReadingWords],
) -> list[Comparison]:
    """Score methods by the ground truth of a recording, as `vo features --compare` does.

    Args:
        recording: of which the left images are used.
        methods: such as `["orb", "sift/flann", "klt"]`, or `all`.
        gaps: frames between the images of a pair.
        pairs: number of pairs for each gap.
        overrides: settings of `features` and `matching`, such as `["features.count=2500"]`.
        picture: plot to write (.png, .pdf, .svg).
        **reading: format, calibration and topics, as for `vo.open`.

    Returns:
        A row for each method and gap.

    Raises:
        SourceError: the recording cannot be read, or has no ground truth.
        ConfigError: a method is unknown, or this build of OpenCV lacks it.
    """
    from vo.tools.laboratory.comparison import compare as compared
    from vo.tools.laboratory.comparison import plan_pairs
    from vo.tools.laboratory.images import open_left_images
    from vo.tools.laboratory.pictures import save_comparison

    chosen, plot = _methods(methods, overrides), _plot(picture)
    source = open_left_images(recording, **reading)
    rows = compared(chosen, plan_pairs(source, _whole(gaps), pairs), source.rig.cam0)
    if plot is not None:
        save_comparison(plot, rows, source.name)
    return rows


def compare_planes(
    first: str | Path,
    methods: str | Sequence[str],
    *,
    second: str | Path | None = None,
    homography: str | Path | None = None,
    overrides: Sequence[str] = (),
    picture: str | Path | None = None,
) -> list[PlaneScore]:
    """Score methods on images of a plane, by homographies within 1, 3 and 5 pixels.

    Args:
        first: folder of HPatches (`1.ppm`, `2.ppm`, `H_1_2`, ...), or an image with a second one
            and the homography from it.
        methods: see `compare`.
        second: another image of the plane.
        homography: 3 x 3 matrix as text, from pixels of the first to those of the second.
        overrides: settings of `features` and `matching`.
        picture: plot to write.

    Returns:
        A row for each method.

    Raises:
        SourceError: there are no such images, or they cannot be read.
        ConfigError: see `compare`.
    """
    from vo.base.errors import SourceError
    from vo.tools.laboratory.images import PlanePair, plane_pairs
    from vo.tools.laboratory.pictures import save_planes
    from vo.tools.laboratory.repeatability import score_planes

    chosen, plot = _methods(methods, overrides), _plot(picture)
    planes = plane_pairs(Path(first))
    if second is not None and homography is not None:
        planes = [PlanePair(Path(first), Path(second), Path(homography))]
    if not planes:
        raise SourceError(
            f"{first} has no images of a plane (1.ppm, 2.ppm, H_1_2, ...); give such a folder, or "
            "an image with `second` and `homography`"
        )
    rows = score_planes(chosen, planes)
    if plot is not None:
        save_planes(plot, rows, Path(first).name)
    return rows


def _methods(given: str | Sequence[str], overrides: Sequence[str]) -> list[Method]:
    from vo.base.config import load_config
    from vo.base.errors import ConfigError
    from vo.tools.laboratory.methods import expand, make_method

    config = load_config("default", list(overrides))
    names = expand([given] if isinstance(given, str) else list(given))
    if not names:
        raise ConfigError("`methods` is empty; give such as ['orb', 'sift', 'klt'], or 'all'")
    return [make_method(name, config.features, config.matching) for name in names]


def _whole(gaps: Sequence[int]) -> list[int]:
    from vo.base.errors import ConfigError

    if not gaps or not all(isinstance(gap, int) and gap >= 1 for gap in gaps):
        raise ConfigError(f"`gaps` is {gaps!r}; give numbers of frames from 1, such as (1, 5, 15)")
    return sorted(set(gaps))


def _plot(picture: str | Path | None) -> Path | None:
    from vo.tools.drawing import check_plot

    if picture is None:
        return None
    check_plot(Path(picture))
    return Path(picture)
