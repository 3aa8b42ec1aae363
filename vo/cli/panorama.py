"""`vo panorama`: one picture of several overlapping images."""

from __future__ import annotations

from pathlib import Path

from vo.cli import options
from vo.cli.blocks import argument, option


def panorama_command(
    images: list[str] = argument(
        "Images in order, or one folder of images; RECORDING:NUMBER for frames of a recording.",
        metavar="IMAGE…",
    ),
    *,
    output: Path = option(
        "The panorama (.png, .jpg).", "--output", "-o", metavar="FILE", panel=options.OUTPUT
    ),
    flat: bool = option(
        "The images show one plane from several places (a page, a wall, the ground from above), "
        "instead of everything from one place.",
        "--flat",
        default=False,
        panel=options.INPUT,
    ),
    calibration: Path | None = option(
        "Calibration of the camera, whose lens distortion is removed.",
        default=None,
        metavar="FILE",
        panel=options.INPUT,
    ),
    printing: options.Printing,
) -> None:
    """Stitch images that overlap by about a third into one picture.

    With a calibration, or that of a recording, by the camera's rotations.
    Seams, exposure and the projection onto a sphere are OpenCV's. Images that
    fit to no other are left out and named.

    From photos of a camera that was turned in one place:

      vo panorama left.jpg middle.jpg right.jpg -o panorama.jpg
    """
    from vo.cli.echo import echo
    from vo.outputs.results.output_paths import refuse_to_overwrite
    from vo.recordings.formats.calibration import read_calibration
    from vo.recordings.sources.listing import list_images
    from vo.recordings.sources.single_image import read_single_image
    from vo.tools.drawing import check_picture, write_picture
    from vo.tools.pairs.pair_options import check_cameras
    from vo.tools.pairs.stitching import panorama, read_in_colour

    check_picture(output)
    given = images
    if len(images) == 1 and Path(images[0]).is_dir():
        given = [str(path) for path in list_images(Path(images[0]))]
    refuse_to_overwrite([*(Path(each) for each in given), calibration], [output])
    with printing.warnings(), printing.errors.status("stitching"):
        shots = [read_in_colour(each) for each in given]
        camera = read_single_image(given[0]).camera  # of a recording
        if calibration is not None:
            height, width = shots[0].shape[:2]
            camera = read_calibration(calibration, (width, height)).rig.cam0
        if camera is not None:
            for name, shot in zip(given, shots, strict=True):
                check_cameras((camera, camera), (shot[:, :, 0],) * 2, (name, name))
        picture = panorama(shots, given, camera, flat=flat)
        write_picture(output, picture)
    height, width = picture.shape[:2]
    printing.show(
        lambda: {"images": given, "width": width, "height": height, "picture": str(output)},
        lambda: echo(f"{output}: {width} x {height} pixels of {len(given)} images"),
    )
