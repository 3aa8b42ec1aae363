"""`vo match`: two images, their matches, and the geometry between them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

import typer

from vo.cli import completion, options
from vo.cli.blocks import argument, block, option

_FEATURES, _GEOMETRY = "Features and matching", "Geometry"


class Matcher(StrEnum):
    """Choices of `--matcher`."""

    BRUTE_FORCE = "brute_force"
    MNN = "mnn"
    FLANN = "flann"
    ANN = "ann"
    GMS = "gms"
    LIGHTGLUE = "lightglue"
    LIGHTERGLUE = "lighterglue"
    SUPERGLUE = "superglue"


class Model(StrEnum):
    """Choices of `--model`."""

    AUTO = "auto"
    FUNDAMENTAL = "f"
    ESSENTIAL = "e"
    HOMOGRAPHY = "h"


class Method(StrEnum):
    """Choices of `--method`."""

    RANSAC = "ransac"
    LMEDS = "lmeds"
    USAC_DEFAULT = "usac_default"
    USAC_FAST = "usac_fast"
    USAC_ACCURATE = "usac_accurate"
    MAGSAC = "magsac"
    PROSAC = "prosac"


@block(_FEATURES)
class PairChoice:
    """Features, matching and geometry."""

    detector: str | None = option(
        "What finds features: orb, sift, fast, shi_tomasi, akaze, ... (docs/features.md).",
        default=None,
        metavar="NAME",
        show_default="orb",
        autocompletion=completion.detectors,
    )
    descriptor: str | None = option(
        "What describes them: rbrief, sift, rootsift, ...",
        default=None,
        metavar="NAME",
        show_default="the detector's own",
        autocompletion=completion.descriptors,
    )
    matcher: Matcher | None = option(
        "Exact search with or without a ratio test (brute_force, mnn), approximate search "
        "(flann, ann), exact search and the support of neighbours instead of a ratio test "
        "(gms), or a learned network.",
        default=None,
        show_default="brute_force, for learned features mnn",
    )
    ratio: float | None = option(
        "Maximum ratio of the best to the second-best distance.",
        default=None,
        metavar="RATIO",
        show_default="0.85",
    )
    cross_check: bool = option(
        "Keep only matches that are the best in both directions.",
        "--cross-check/--no-cross-check",
        default=True,
    )
    config: str = option(
        "Settings: a preset or a YAML file.",
        default="default",
        metavar="PRESET|FILE",
        autocompletion=completion.presets,
    )
    set_values: list[str] | None = option(
        "Override a setting, such as features.count=3000; repeatable.",
        "--set",
        default=None,
        metavar="KEY=VALUE",
    )
    model: Model = option(
        "Fundamental or essential matrix (needs a calibration), homography, or the one "
        "that explains the matches best.",
        default=Model.AUTO,
        panel=_GEOMETRY,
    )
    method: Method = option(
        "How it is found among wrong matches.", default=Method.USAC_ACCURATE, panel=_GEOMETRY
    )
    threshold: float = option(
        "Maximum Sampson distance of an inlier.", default=1.5, metavar="PX", panel=_GEOMETRY
    )


def match_command(
    first: str = argument(
        "First image: a file, or RECORDING:NUMBER for a frame of a recording.", metavar="A"
    ),
    second: str = argument("Second image.", metavar="B"),
    *,
    calibration: Path | None = option(
        "Calibration of the camera, for the motion: any format of `vo run`.",
        default=None,
        metavar="FILE",
        show_default="that of the recording",
        panel=options.INPUT,
    ),
    right: bool = option(
        "B is of the right camera.", "--right", default=False, panel=options.INPUT
    ),
    masks: options.MaskOptions,
    given: PairChoice,
    picture: Path | None = option(
        "Draw both images side by side, inliers green and other matches red, to this .png or "
        ".jpg file.",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    ),
    epipolar: bool = option(
        "Draw epipolar lines in the picture.", "--epipolar", default=False, panel=options.OUTPUT
    ),
    printing: options.Printing,
) -> None:
    """Match two images, and find the geometry and the motion between them.

    The motion needs a calibration; the length of its translation is unknown
    with two images, so that only its direction is given.

    Match two images by SIFT, and draw what was found:

      vo match a.png b.png --detector sift --picture matches.png

    Motion between two frames of a recording, with epipolar lines:

      vo match my_sequence:0 my_sequence:15 --picture ab.png --epipolar

    Exit status: 0 a model was found, 1 none, or an error, 2 wrong usage.
    """
    from vo.base.config import load_config
    from vo.base.errors import ConfigError
    from vo.cli.console import standard_error
    from vo.cli.match_table import print_failures, print_pair
    from vo.outputs.results.output_paths import refuse_to_overwrite
    from vo.recordings.formats.calibration import read_calibration
    from vo.recordings.sources.single_image import read_single_image
    from vo.tools.pairs.image_pair import match_images, pair_record
    from vo.tools.pairs.pair_options import (
        check_cameras,
        pair_cameras,
        pair_masks,
        pair_options,
    )

    if epipolar and picture is None:
        raise ConfigError("--epipolar needs --picture FILE, where the lines are drawn")
    read = [text for each in (first, second) for text in (each, each.rpartition(":")[0])]
    refuse_to_overwrite([*(Path(text) for text in read if text), calibration], [picture])
    settings = load_config(given.config, [*(given.set_values or []), *masks.settings])
    with printing.details(), printing.errors.status("matching"):
        shots = (read_single_image(first), read_single_image(second, right=right))
        images = (shots[0].image, shots[1].image)
        size = (images[0].shape[1], images[0].shape[0])
        rig = None if calibration is None else read_calibration(calibration, size).rig
        cameras = pair_cameras(rig, (shots[0].camera, shots[1].camera), right=right)
        names = (shots[0].name, shots[1].name)
        check_cameras(cameras, images, names)
        chosen = pair_options(
            settings,
            {
                "detector": given.detector,
                "descriptor": given.descriptor,
                "matcher": None if given.matcher is None else given.matcher.value,
                "ratio": given.ratio,
                "cross_check": None if given.cross_check else False,
                "model": given.model.value,
                "method": given.method.value,
                "threshold_px": given.threshold,
            },
            cameras,
        )
        pair = match_images(images, chosen, pair_masks(settings, images, right=right))
        if picture is not None:
            from vo.tools.pairs.pair_picture import write_pair_picture

            write_pair_picture(picture, images, pair, epipolar=epipolar)
    written = None if picture is None else str(picture)
    printing.show(
        lambda: pair_record(pair, chosen, names) | {"picture": written},
        lambda: print_pair(pair, chosen, names, picture),
    )
    if printing.quiet and not printing.json_output:
        print_failures(pair, standard_error())
    if pair.fit is None:
        raise typer.Exit(1)
