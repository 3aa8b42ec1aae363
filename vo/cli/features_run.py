"""What `vo features` does: one image, two images of a plane, or pairs of a recording."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console

from vo.base.config import Config, load_config
from vo.base.errors import ConfigError
from vo.base.feature_settings import OWN_NETWORK
from vo.cli.features_table import FeaturesResult
from vo.cli.opening import open_one_camera
from vo.cli.progress import counting
from vo.engine.features.detectors import DETECTORS
from vo.engine.features.opencv import describe_missing
from vo.tools.drawing import check_plot
from vo.tools.laboratory.comparison import compare, plan_pairs
from vo.tools.laboratory.examination import examine
from vo.tools.laboratory.images import (
    GreyImage,
    PlanePair,
    is_image,
    open_left_images,
    plane_pairs,
    read_frame,
    read_image,
)
from vo.tools.laboratory.methods import KLT, Method, expand, make_method, missing_detectors
from vo.tools.laboratory.pictures import (
    check_picture,
    save_comparison,
    save_features,
    save_planes,
)
from vo.tools.laboratory.repeatability import score_planes

if TYPE_CHECKING:
    from vo.cli.features import Request

_log = logging.getLogger(__name__)
_SECTIONS = ("features.", "matching.")
_ALL = "all"


def run_request(request: Request, console: Console) -> FeaturesResult:
    """Do what the options ask for.

    Raises:
        VoError: options that do not go together, or an input that cannot be used.
    """
    _check(request)
    methods = _methods(request)
    if request.second is not None and request.homography is not None:
        pair = PlanePair(request.target, request.second, request.homography)
        return _compare_planes(request, [pair], methods, console)
    pairs = plane_pairs(request.target)
    if pairs:
        return _compare_planes(request, pairs, methods, console)
    if request.compare is None or request.frame is not None or is_image(request.target):
        return _examine(request, methods, console)
    return _compare_frames(request, methods, console)


def _check(request: Request) -> None:
    shown_alone = is_image(request.target) or request.second is not None
    if (request.second is None) != (request.homography is None):
        raise ConfigError(
            "methods are scored on two images by a known homography; give both SECOND and "
            "--homography FILE (vo match shows the matches of any two images)"
        )
    if shown_alone and request.frame is not None:
        raise ConfigError(f"--frame is of a recording; {request.target} is an image")
    if request.compare is not None and (request.detector or request.descriptor):
        raise ConfigError("use --detector and --descriptor without --compare, which names both")
    for text in request.settings or ():
        if not text.startswith(_SECTIONS):
            raise ConfigError(
                f"--set {text} has no effect on vo features; give features.… or matching.…"
            )


def _methods(request: Request) -> list[Method]:
    config = load_config("default", request.settings or [])
    if request.compare is None:
        detector = request.detector or config.features.detector
        descriptor = request.descriptor or config.features.descriptor
        name = detector if descriptor == "auto" else f"{detector}+{descriptor}"
        return [make_method(name, config.features, config.matching)]
    texts = [text.strip() for text in request.compare.split(",") if text.strip()]
    if not texts:
        raise ConfigError("--compare names no method; give such as orb,sift,klt, or all")
    if _ALL in texts:
        _warn_of_missing()
    return [_method(name, config) for name in expand(texts)]


def _method(name: str, config: Config) -> Method:
    return make_method(name, config.features, config.matching)


def _warn_of_missing() -> None:
    missing = missing_detectors()
    if missing:
        described = describe_missing({name: DETECTORS[name].algorithm for name in missing})
        _log.warning("left out: %s", described)


def _examine(request: Request, methods: Sequence[Method], console: Console) -> FeaturesResult:
    """Features of one image, by each method."""
    if request.picture is not None:
        if len(methods) > 1:
            raise ConfigError("--picture shows the features of one method; leave --compare out")
        check_picture(request.picture)
    if request.compare is not None:  # methods that differ in their matcher find the same
        names = [_features_of(method.name) for method in methods]
        methods = [m for i, m in enumerate(methods) if names[i] not in names[:i]]
    image, frame = _image(request)
    reports = []
    with counting(console, request.target.name, len(methods)) as step:
        for method in methods:
            step(method.name)
            report, found = examine(method, image)
            reports.append(report)
    if request.picture is not None:
        save_features(request.picture, image.pixels, found, methods[0].sizes(found))
    height, width = image.pixels.shape
    return FeaturesResult(
        str(request.target),
        (width, height),
        frame,
        reports=tuple(reports),
        picture=request.picture,
    )


def _features_of(name: str) -> str:
    if name.startswith(OWN_NETWORK):
        return name
    features, _, matcher = name.partition("/")
    return name if matcher == KLT else features


def _image(request: Request) -> tuple[GreyImage, int | None]:
    if is_image(request.target):
        return read_image(request.target), None
    number = request.frame or 0
    recording, _ = open_one_camera(request.target, request.reading)
    frame = read_frame(recording, number)
    return GreyImage(frame.image0, frame.mask), number


def _compare_planes(
    request: Request, pairs: Sequence[PlanePair], methods: Sequence[Method], console: Console
) -> FeaturesResult:
    if request.picture is not None:
        check_plot(request.picture)
    if _ALL in (request.compare or ""):
        methods = _of_these_sizes(methods, pairs)
    with counting(console, request.target.name, len(pairs) * len(methods)) as step:
        means = tuple(score_planes(methods, pairs, step))
    if request.picture is not None:
        save_planes(request.picture, means, request.target.name)
    height, width = read_image(pairs[-1].first).pixels.shape
    return FeaturesResult(
        str(request.target), (width, height), None, planes=means, picture=request.picture
    )


def _of_these_sizes(methods: Sequence[Method], pairs: Sequence[PlanePair]) -> Sequence[Method]:
    """All methods; without those that need images of one size, if they differ."""
    sizes = ((read_image(each.first).pixels, read_image(each.second).pixels) for each in pairs)
    if all(first.shape == second.shape for first, second in sizes):
        return methods
    _log.warning("left out: optical flow, as the images differ in size")
    return [method for method in methods if not method.needs_one_size]


def _compare_frames(
    request: Request, methods: Sequence[Method], console: Console
) -> FeaturesResult:
    if request.picture is not None:
        check_plot(request.picture)
    reading = request.reading
    recording = open_left_images(
        request.target,
        format=reading.format,
        calibration=reading.calibration,
        topics=reading.topics,
    )
    pairs = plan_pairs(recording, _gaps(request.gaps), request.pairs)
    with counting(console, recording.name, len(pairs) * len(methods)) as step:
        rows = compare(methods, pairs, recording.rig.cam0, step)
    if request.picture is not None:
        save_comparison(request.picture, rows, recording.name)
    camera = recording.rig.cam0
    return FeaturesResult(
        str(request.target),
        (camera.width, camera.height),
        None,
        rows=tuple(rows),
        picture=request.picture,
    )


def _gaps(text: str) -> list[int]:
    try:
        gaps = sorted({int(word) for word in text.split(",") if word.strip()})
    except ValueError:
        gaps = []
    if not gaps or gaps[0] < 1:
        raise ConfigError(f"--gaps is '{text}'; give numbers of frames from 1, such as 1,5,15")
    return gaps
