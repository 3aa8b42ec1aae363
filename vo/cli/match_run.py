"""What `vo match` does: two images, or pairs of a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from vo.base.config import Config, load_config
from vo.base.errors import ConfigError
from vo.base.types import Bytes, Camera, Floats
from vo.cli.console import standard_error
from vo.cli.match_table import print_failures, print_pair, print_set
from vo.cli.messages import warnings_on
from vo.cli.progress import counting
from vo.outputs.results.output_paths import refuse_to_overwrite
from vo.recordings.formats.calibration import read_calibration
from vo.recordings.sources.listing import list_images
from vo.recordings.sources.single_image import SingleImage, read_single_image
from vo.tools.drawing import check_picture
from vo.tools.pairs.image_pair import (
    ImageFeatures,
    ImagePair,
    PairMatcher,
    PairOptions,
    keypoint_record,
    pair_record,
)
from vo.tools.pairs.image_set import image_set, match_set
from vo.tools.pairs.match_files import check_match_files, match_files
from vo.tools.pairs.pair_options import (
    check_cameras,
    pair_baseline,
    pair_cameras,
    pair_masks,
    pair_options,
    region_masks,
)
from vo.tools.pairs.pair_picture import write_pair_picture
from vo.tools.pairs.stitching import read_in_colour, write_warped

if TYPE_CHECKING:
    from vo.cli.match import Request

_WITH_TWO = ("picture", "warp", "epipolar", "best", "keypoints", "right", "roi_a", "roi_b")
_WITH_A_FOLDER = ("pairs", "window")


def run_request(request: Request) -> bool:
    """Do what the options ask for; returns whether any two images have a model.

    Raises:
        VoError: options that do not go together, or an input that cannot be used.
    """
    is_set = request.second is None
    for name in _WITH_TWO if is_set else _WITH_A_FOLDER:
        if getattr(request, name) not in (None, False):
            needed = "two images, A and B" if is_set else "one folder"
            raise ConfigError(f"`{name}` needs {needed}")
    for name in ("epipolar", "best"):
        if getattr(request, name) and request.picture is None:
            raise ConfigError(f"`{name}` needs `picture=FILE`, where the lines are drawn")
    if request.keypoints and not request.printing.json_output:
        raise ConfigError("--keypoints needs --json, which they are added to")
    check_match_files(request.output or ())
    return _match_folder(request) if is_set else _match_two(request)


class _Two(NamedTuple):
    """Two images, and what is known of their cameras."""

    given: tuple[str, str]
    shots: tuple[SingleImage, SingleImage]
    cameras: tuple[Camera, Camera] | None
    baseline: Floats | None

    @property
    def names(self) -> tuple[str, str]:
        return self.shots[0].name, self.shots[1].name

    @property
    def images(self) -> tuple[Bytes, Bytes]:
        return self.shots[0].image, self.shots[1].image


def _match_two(request: Request) -> bool:
    given = (request.first, request.second or "")
    read = [text for each in given for text in (each, each.rpartition(":")[0])]
    outputs = [request.picture, request.warp, *(request.output or ())]
    refuse_to_overwrite([*(Path(text) for text in read if text), request.calibration], outputs)
    for picture in (request.picture, request.warp):
        if picture is not None:
            check_picture(picture)
    settings = _settings(request)
    errors = request.printing.errors
    warned = warnings_on(lambda: errors, quiet=True)
    with request.printing.details(), warned, errors.status("matching"):
        two = _read(request, given)
        chosen = _options(request, settings, two.cameras, two.baseline)
        masks = pair_masks(settings, two.images, right=request.right)
        masks = region_masks(masks, two.images, (request.roi_a or (), request.roi_b or ()))
        matcher = PairMatcher(chosen)
        features = [matcher.extract(*each) for each in zip(two.images, masks, strict=True)]
        pair = matcher.match(*features)
        written = _write(request, two, features, pair)
    request.printing.show(
        lambda: (
            pair_record(pair, chosen, two.names)
            | (keypoint_record(pair) if request.keypoints else {})
            | {name: written.get(name) for name in ("picture", "warp")}
            | {"outputs": [str(path) for path in request.output or ()]}
        ),
        lambda: print_pair(pair, chosen, two.names, list(written.values())),
    )
    if request.printing.quiet and not request.printing.json_output:
        print_failures(pair, standard_error())
    return pair.fit is not None


def _read(request: Request, given: tuple[str, str]) -> _Two:
    shots = read_single_image(given[0]), read_single_image(given[1], right=request.right)
    rig = None
    if request.calibration is not None:
        height, width = shots[0].image.shape
        rig = read_calibration(request.calibration, (width, height)).rig
    cameras = pair_cameras(rig, (shots[0].camera, shots[1].camera), right=request.right)
    two = _Two(given, shots, cameras, pair_baseline(rig, shots, right=request.right))
    check_cameras(cameras, two.images, two.names)
    return two


def _write(
    request: Request, two: _Two, features: Sequence[ImageFeatures], pair: ImagePair
) -> dict[str, str]:
    """Write the files that were asked for; their paths, pictures by their option."""
    written = {}
    if request.picture is not None:
        epipolar, best = request.epipolar, request.best
        write_pair_picture(request.picture, two.images, pair, epipolar=epipolar, best=best)
        written["picture"] = str(request.picture)
    if request.warp is not None and pair.fit is not None:
        first, second = map(read_in_colour, two.given)
        write_warped(request.warp, (first, second), pair)
        written["warp"] = str(request.warp)
    with match_files(request.output or ()) as files:
        for file in files:
            for name, found, camera in zip(
                two.names, features, two.cameras or (None, None), strict=True
            ):
                file.add_image(name, found, camera)
            file.add_pair(0, 1, pair)
    return written | {str(path): str(path) for path in request.output or ()}


def _match_folder(request: Request) -> bool:
    folder = Path(request.first)
    if not folder.is_dir():
        raise ConfigError(f"{folder} is one image; give a second one, or a folder of images")
    refuse_to_overwrite([folder, request.pairs, request.calibration], request.output or ())
    settings = _settings(request)
    images = image_set(folder, request.pairs, request.window)
    cameras = None
    if request.calibration is not None:
        shape = read_single_image(list_images(folder)[0]).image.shape
        camera = read_calibration(request.calibration, (shape[1], shape[0])).rig.cam0
        cameras = (camera, camera)
    options = _options(request, settings, cameras, None)
    total = len(images.names) + len(images.pairs)
    console = request.printing.errors
    with (
        request.printing.warnings(),
        counting(console, folder.name, total) as step,
        match_files(request.output or ()) as files,
    ):
        counts = match_set(images, options, files, step)
    written = [str(path) for path in request.output or ()]
    request.printing.show(
        lambda: {
            "folder": str(folder),
            "images": list(images.names),
            "pairs": [each._asdict() for each in counts],
            "outputs": written,
        },
        lambda: print_set(images, counts, written),
    )
    return any(each.model is not None for each in counts)


def _settings(request: Request) -> Config:
    given, masks = request.given, request.masks
    return load_config(given.config, [*(given.set_values or []), *masks.settings])


def _options(
    request: Request,
    settings: Config,
    cameras: tuple[Camera, Camera] | None,
    baseline: Floats | None,
) -> PairOptions:
    given = request.given
    model = given.model.value
    if request.warp is not None:
        if model not in ("auto", "h"):
            raise ConfigError("`warp` needs a homography; leave `model` out, or give `model=h`")
        model = "h"
    return pair_options(
        settings,
        {
            "detector": given.detector,
            "descriptor": given.descriptor,
            "matcher": None if given.matcher is None else given.matcher.value,
            "ratio": given.ratio,
            "cross_check": None if given.cross_check else False,
            "model": model,
            "method": given.method.value,
            "threshold_px": given.threshold,
        },
        cameras,
        baseline,
    )
