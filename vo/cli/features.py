"""`vo features`: what detectors find in an image, and how methods compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from vo.cli import completion, options
from vo.cli.blocks import Only, argument, block, option

_METHOD, _COMPARISON = "Method", "Comparison"


@block(_COMPARISON)
class Request:
    """Arguments and options of the command."""

    target: Path = argument(
        "An image, a recording in any format of vo run, or a folder of HPatches (1.ppm, 2.ppm, "
        "H_1_2, …).",
        metavar="TARGET",
    )
    second: Path | None = argument(
        "A second image of the same plane, with --homography.",
        default=None,
        metavar="SECOND",
        show_default=False,
    )
    detector: str | None = option(
        "Detector (docs/features.md).",
        default=None,
        metavar="NAME",
        show_default="orb",
        autocompletion=completion.detectors,
        panel=_METHOD,
    )
    descriptor: str | None = option(
        "Descriptor.",
        default=None,
        metavar="NAME",
        show_default="the detector's own",
        autocompletion=completion.descriptors,
        panel=_METHOD,
    )
    settings: list[str] | None = option(
        "A setting of features or matching, as for vo run; repeatable.",
        "--set",
        default=None,
        metavar="SECTION.KEY=VALUE",
        panel=_METHOD,
    )
    compare: str | None = option(
        "Compare methods, such as orb,sift,fast+brisk,sift/flann,klt, or all: by the "
        "ground truth of a recording, by --homography, or in one image.",
        default=None,
        metavar="METHODS",
    )
    gaps: str = option("Frames between the images of a pair.", default="1,5,15,30", metavar="N,N")
    pairs: int = option("Number of pairs for each gap.", default=8, min=1, metavar="N")
    homography: Path | None = option(
        "3 x 3 matrix that takes pixels of TARGET to those of SECOND, as text (HPatches).",
        default=None,
        metavar="FILE",
    )
    frame: int | None = option(
        "Frame of the recording to show; its left image is used.",
        default=None,
        min=0,
        metavar="N",
        show_default="0",
        panel=options.INPUT,
    )
    reading: Annotated[options.Reading, Only("calibration", "format", "topic")]
    picture: Path | None = option(
        "Draw the features of an image to this PNG file, or plot the comparison of a "
        "recording or of planes (.png, .pdf, .svg).",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    )


def features_command(
    request: Request,
    printing: options.Printing,
) -> None:
    """Detect features in an image or a frame, or compare methods of matching.

    A method is DETECTOR or DETECTOR+DESCRIPTOR, perhaps with /MATCHER, or klt
    for optical flow. Times are CPU times of one thread.

    Show what a detector finds:

      vo features photo.jpg --detector sift --picture features.png

    Compare methods on a recording with ground truth, then use the winner:

      vo features my_sequence/ --compare orb,sift,klt --picture methods.png
      vo run my_sequence/ -o out/ --set features.detector=sift

    Compare methods on images of a plane, by homographies within 1, 3 and 5 px:

      vo features 1.ppm 2.ppm --homography H_1_2 --compare orb,sift
      vo features v_boat/ --compare orb,sift --picture accuracy.png
    """
    from vo.cli.features_run import run_request
    from vo.outputs.results.output_paths import refuse_to_overwrite

    inputs = (request.target, request.second, request.reading.calibration, request.homography)
    refuse_to_overwrite(inputs, (request.picture,))
    with printing.warnings():
        result = run_request(request, printing.errors)
    printing.show(result.to_dict, result.show)
