"""`vo info`: what a recording holds and what is wrong with it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from vo.cli.run import ModeChoice


def info_command(
    source: Annotated[
        Path,
        typer.Argument(metavar="RECORDING", help="Anything that `vo run` takes, sound or not."),
    ],
    contact_sheet: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Draw images spread over the recording into this PNG file."
        ),
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print JSON for machines instead of text.")
    ] = False,
    all_images: Annotated[
        bool, typer.Option("--all", help="Look at every image, not at 24 of each camera.")
    ] = False,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Calibration instead of the recording's own."),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="Of the recording, as for `vo run`.",
            show_default="found out from its files",
        ),
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TOPIC",
            help="Camera of a log, as for `vo run`; may be given again.",
            show_default="found out from the names",
        ),
    ] = None,
    mode: Annotated[
        ModeChoice, typer.Option(help="mono ignores the right camera, stereo insists on it.")
    ] = ModeChoice.AUTO,
) -> None:
    """Show what a recording holds, what is wrong with it, and how to run it.

    Stamps of all images are looked at, pixels of some. It also works where
    `vo run` refuses, and says why.

      vo info log.mcap --contact-sheet sheet.png

    Exit status: 1 if there is a problem, 0 if there are warnings at most.
    """
    import json
    from dataclasses import asdict

    from rich.console import Console

    from vo.inspection.material import look_into
    from vo.inspection.report import DEFAULT_IMAGES, inspect
    from vo.results.claim import refuse_to_overwrite

    refuse_to_overwrite((source, calibration), (contact_sheet,))

    with Console(stderr=True).status("looking at images"):
        material = look_into(
            source, format=format, calibration=calibration, mode=mode.value, topics=topic or ()
        )
        report = inspect(material, None if all_images else DEFAULT_IMAGES)
        if not material.cameras:
            contact_sheet = None  # the report says why there is nothing to draw
        if contact_sheet is not None:
            from vo.inspection.sheet import write_sheet

            write_sheet(contact_sheet, material)
    if json_output:
        typer.echo(json.dumps(asdict(report), indent=2, allow_nan=False))
    else:
        from vo.cli.info_table import print_report

        print_report(report, contact_sheet)
    if any(finding.level == "error" for finding in report.findings):
        raise typer.Exit(1)
