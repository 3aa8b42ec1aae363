"""`vo features`: what detectors find in an image, and how methods compare."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from vo.cli import completion, options
from vo.cli.blocks import Only

_METHOD, _COMPARISON = "Method", "Comparison"


@dataclass(frozen=True, kw_only=True)
class Request:
    """Arguments and options of the command."""

    target: Annotated[
        Path,
        typer.Argument(metavar="TARGET", help="An image, or a recording in any format of vo run."),
    ]
    second: Annotated[
        Path | None,
        typer.Argument(
            metavar="SECOND",
            help="A second image of the same plane, with --homography.",
            show_default=False,
        ),
    ] = None
    detector: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Detector (docs/features.md).",
            show_default="orb",
            autocompletion=completion.detectors,
            rich_help_panel=_METHOD,
        ),
    ] = None
    descriptor: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Descriptor.",
            show_default="the detector's own",
            autocompletion=completion.descriptors,
            rich_help_panel=_METHOD,
        ),
    ] = None
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="SECTION.KEY=VALUE",
            help="A setting of features or matching, as for vo run; repeatable.",
            rich_help_panel=_METHOD,
        ),
    ] = None
    compare: Annotated[
        str | None,
        typer.Option(
            metavar="METHODS",
            help="Compare methods, such as orb,sift,fast+brisk,sift/flann,klt, or all: by the "
            "ground truth of a recording, by --homography, or in one image.",
            rich_help_panel=_COMPARISON,
        ),
    ] = None
    gaps: Annotated[
        str,
        typer.Option(
            metavar="N,N",
            help="Frames between the images of a pair.",
            rich_help_panel=_COMPARISON,
        ),
    ] = "1,5,15,30"
    pairs: Annotated[
        int,
        typer.Option(
            min=1, metavar="N", help="Number of pairs for each gap.", rich_help_panel=_COMPARISON
        ),
    ] = 8
    homography: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="3 x 3 matrix that takes pixels of TARGET to those of SECOND, as text (HPatches).",
            rich_help_panel=_COMPARISON,
        ),
    ] = None
    frame: Annotated[
        int | None,
        typer.Option(
            "--frame",
            min=0,
            metavar="N",
            help="Frame of the recording to show; its left image is used.",
            show_default="0",
            rich_help_panel=options.INPUT,
        ),
    ] = None
    reading: Annotated[options.Reading, Only("calibration", "format", "topic")]
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Draw the features of an image to this PNG file, or plot the comparison of a "
            "recording (.png, .pdf, .svg).",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None


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

    Compare methods on two images of a plane:

      vo features 1.ppm 2.ppm --homography H_1_2 --compare orb,sift
    """
    from vo.cli.features_run import run_request
    from vo.outputs.results.output_paths import refuse_to_overwrite

    inputs = (request.target, request.second, request.reading.calibration, request.homography)
    refuse_to_overwrite(inputs, (request.picture,))
    with printing.warnings():
        result = run_request(request, printing.errors)
    printing.show(result.to_dict, result.show)
