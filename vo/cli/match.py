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


@block(options.INPUT)
class Request:
    """Arguments and options of the command."""

    first: str = argument(
        "First image: a file, or RECORDING:NUMBER for a frame of a recording; or a folder of "
        "images, of which all pairs are matched.",
        metavar="A|DIR",
    )
    second: str | None = argument("Second image.", default=None, metavar="B", show_default=False)
    pairs: Path | None = option(
        "Match the pairs of this text file, with two names below DIR in each line.",
        default=None,
        metavar="FILE",
        show_default="all pairs",
    )
    window: int | None = option(
        "Match images of DIR that are at most N apart in the order of their names.",
        default=None,
        min=1,
        metavar="N",
    )
    calibration: Path | None = option(
        "Calibration of the camera, for the motion: any format of `vo run`.",
        default=None,
        metavar="FILE",
        show_default="that of the recording",
    )
    right: bool = option(
        "B is of the right camera; of one time, the motion is the calibrated one, in metres.",
        "--right",
        default=False,
    )
    masks: options.MaskOptions
    roi_a: list[str] | None = option(
        "Use only this area of A, as --roi; repeatable.",
        "--roi-a",
        default=None,
        metavar="AREA",
    )
    roi_b: list[str] | None = option(
        "Use only this area of B.", "--roi-b", default=None, metavar="AREA"
    )
    given: PairChoice
    output: list[Path] | None = option(
        "Write keypoints, matches and geometry: .csv, .npz, .h5 (HDF5), or .db (COLMAP "
        "database). Repeatable.",
        "--output",
        "-o",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )
    picture: Path | None = option(
        "Draw both images side by side, inliers blue and other matches orange, to this .png or "
        ".jpg file.",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )
    best: int | None = option(
        "Draw only the N matches with the most similar descriptors.",
        default=None,
        min=1,
        metavar="N",
        panel=options.OUTPUT,
    )
    epipolar: bool = option(
        "Draw epipolar lines in the picture.", "--epipolar", default=False, panel=options.OUTPUT
    )
    warp: Path | None = option(
        "Draw A as B sees it, by the homography, in one picture with B (.png, .jpg).",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )
    keypoints: bool = option(
        "Add all keypoints and matches to --json.",
        "--keypoints",
        default=False,
        panel=options.OUTPUT,
    )
    printing: options.Printing


def match_command(request: Request) -> None:
    """Match images, and find the geometry and the motion between them.

    The motion needs a calibration; the length of its translation is unknown
    with two images, so that only its direction is given.

    Match two images by SIFT, and draw what was found:

      vo match a.png b.png --detector sift --picture matches.png

    Motion between two frames of a recording, with epipolar lines:

      vo match my_sequence:0 my_sequence:15 --picture ab.png --epipolar

    All pairs of a folder, for COLMAP and for Python:

      vo match photos/ -o photos.db -o photos.npz

    Exit status: 0 a model was found, 1 none, or an error, 2 wrong usage.
    """
    from vo.cli.match_run import run_request

    if not run_request(request):
        raise typer.Exit(1)
