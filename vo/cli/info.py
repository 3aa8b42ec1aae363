"""`vo info`: contents and problems of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from vo.cli import options
from vo.cli.echo import echo_json

Picture = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Write a contact sheet of evenly spaced images to this PNG file.",
        rich_help_panel=options.OUTPUT,
    ),
]
AllImages = Annotated[
    bool,
    typer.Option(
        "--all",
        help="Check all images and inertial samples, not 24 images per camera.",
        rich_help_panel=options.INPUT,
    ),
]


def info_command(
    source: options.Recording,
    picture: Picture = None,
    json_output: options.Json = False,
    all_images: AllImages = False,
    calibration: options.Calibration = None,
    format: options.Format = None,
    topic: options.Topics = None,
    right_offset: options.RightOffset = None,
    mode: options.Mode = options.ModeChoice.AUTO,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Show what a recording contains, its problems, and how to run it.

    Checks all stamps and some of the images. Also inspects recordings that
    `vo run` refuses, and reports the reason.

    Inspect a log, and save some of its images:

      vo info log.mcap --picture sheet.png

    Exit status: 0 no problem, 1 at least one problem (not for warnings),
    2 wrong usage.
    """
    from dataclasses import asdict

    from vo.cli.console import standard_error
    from vo.cli.info_table import print_findings, print_report
    from vo.cli.progress import details_on
    from vo.outputs.results.output_paths import refuse_to_overwrite
    from vo.tools.inspection.opening import open_leniently
    from vo.tools.inspection.report import DEFAULT_IMAGES, inspect

    refuse_to_overwrite((source, calibration), (picture,))

    errors = standard_error()
    with details_on(errors), standard_error(quiet=quiet).status("checking images"):
        opened = open_leniently(
            source,
            format=format,
            calibration=calibration,
            mode=mode.value,
            topics=topic or (),
            right_offset_ns=options.offset_ns(right_offset),
        )
        report = inspect(opened, None if all_images else DEFAULT_IMAGES)
        if not opened.cameras:
            picture = None  # the report contains the reason
        if picture is not None:
            from vo.tools.inspection.contact_sheet import write_contact_sheet

            write_contact_sheet(picture, opened)
    if json_output:
        echo_json(asdict(report) | {"picture": None if picture is None else str(picture)})
    elif quiet:
        print_findings([f for f in report.findings if f.level != "note"], errors)
    else:
        print_report(report, picture)
    if any(finding.level == "error" for finding in report.findings):
        raise typer.Exit(1)
