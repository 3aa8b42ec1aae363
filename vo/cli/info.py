"""`vo info`: contents and problems of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from vo.cli import options
from vo.cli.blocks import Only, option


def info_command(
    source: options.Recording,
    *,
    picture: Path | None = option(
        "Write a contact sheet of evenly spaced images to this PNG file, and a rig from above.",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    ),
    printing: options.Printing,
    all_images: bool = option(
        "Check all images and inertial samples, not 24 images per camera.",
        "--all",
        default=False,
        panel=options.INPUT,
    ),
    reading: Annotated[
        options.Reading, Only("calibration", "format", "topic", "right_offset", "mode")
    ],
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
    from vo.outputs.results.output_paths import refuse_to_overwrite
    from vo.tools.inspection.inspection import DEFAULT_IMAGES, inspect
    from vo.tools.inspection.opening import open_leniently

    refuse_to_overwrite((source, reading.calibration), (picture,))

    with printing.details(), printing.errors.status("checking images"):
        opened = open_leniently(source, **reading.keywords)
        report = inspect(opened, None if all_images else DEFAULT_IMAGES)
        if not opened.cameras:
            picture = None  # the report contains the reason
        if picture is not None:
            from vo.tools.inspection.images import write_contact_sheet

            write_contact_sheet(picture, opened)
    written = None if picture is None else str(picture)
    printing.show(
        lambda: asdict(report) | {"picture": written}, lambda: print_report(report, picture)
    )
    if printing.quiet and not printing.json_output:
        findings = [f for f in report.findings if f.level != "note"]
        print_findings(findings, standard_error())
    if any(finding.level == "error" for finding in report.findings):
        raise typer.Exit(1)
