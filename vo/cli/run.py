"""`vo run`: visual odometry on a recording."""

from __future__ import annotations

from pathlib import Path

import typer

from vo.cli.blocks import argument, block, option
from vo.cli.options import OUTPUT, Frames, MaskOptions, Printing, Reading
from vo.cli.run_options import Live, Outputs, Scale, Settings, Viewer


@block(OUTPUT)
class RunRequest:
    """All arguments and options of `vo run`."""

    source: str = argument(
        "MCAP file (- for standard input), ROS bag, video, folder of KITTI, KITTI raw, "
        "EuRoC or TUM RGB-D, folder of images (or of left/ and right/), or a quoted glob "
        "pattern. Live: camera:0, camera:0,1 (stereo), /dev/video0, rtsp://HOST/PATH, "
        "http://HOST/PATH, realsense:, oak: or zed:.",
        metavar="RECORDING",
    )
    output: Path = option(
        "Folder for the results; created if missing.", "--output", "-o", metavar="FOLDER"
    )
    reading: Reading
    live: Live
    frames: Frames
    masks: MaskOptions
    settings: Settings
    scale: Scale
    viewer: Viewer
    outputs: Outputs
    printing: Printing

    @property
    def is_piped(self) -> bool:
        """Whether the recording is read from standard input."""
        return self.source == "-"


def run_command(request: RunRequest) -> None:
    """Estimate the trajectory of a camera from a recording.

    Writes trajectory.tum (smoothed), causal.tum (as known at each frame),
    poses.csv, covariance.csv, frames.csv, summary.json and config.yaml to the
    output folder, replacing those of an earlier run. Ctrl-C keeps the results
    so far. Frames without a pose are listed in the summary.

    Run on a stereo recording, and record the run for the rerun viewer:

      vo run my_sequence/ --output out/ --rrd out/run.rrd

    Run on images of your own camera (for the file see docs/calibration.md):

      vo run images/ -o out/ --calibration camera.yaml

    Use one camera, and get the scale from GPS (see docs/scale.md):

      vo run drive.mp4 -o out/ --mode mono --gps gps.nmea

    Further examples. Use the left camera, the first 500 frames, and more features:

      vo run my_sequence/ -o out/ --mode mono --end 500 --set features.count=2500

    Pass each pose to another program as soon as it is known (docs/outputs.md):

      vo run my_sequence/ -o out/ --poses - | jq .world_from_cam0

    Run on a live camera until Ctrl-C (see docs/live.md):

      vo run camera:0 -o out/ --calibration camera.yaml --serve

    Keep the map of a recording, and find the poses of another one in it (see docs/memory.md):

      vo run monday/ -o monday-out/ --save-map house.map
      vo run tuesday/ -o tuesday-out/ --map house.map

    Leave out the car's own bonnet and burnt-in text (see docs/recordings.md):

      vo run drive.mp4 -o out/ --mask bonnet.png --ignore 0,0,400,24

    Use it in a script, and let it fail unless nearly all frames have a pose:

      vo run my_sequence/ -o out/ --json --fail-under 95% > summary.json

    Exit status: 0 finished, even if frames are lost (with a warning), 1 error,
    2 wrong usage, 3 no frame has a pose, 4 --fail-under is not reached,
    130 stopped by Ctrl-C, 143 by SIGTERM, 141 if the reader of --poses -
    ended before the run.
    """
    from vo.cli.run_execution import execute

    outputs = request.outputs
    if request.printing.json_output and outputs.poses_on_standard_output:
        raise typer.BadParameter("--json and --poses - both need standard output; use one of them")
    execute(request)
