"""The path of a recording, frame by frame: python examples/recording.py RECORDING."""

import sys

import vo

recording = vo.open(sys.argv[1])
with vo.Odometry(recording.rig) as odometry:
    for frame in recording.frames():
        estimate = odometry.track(frame.stamp_ns, frame.image0, frame.image1, frame.depth)
        print(frame.index, estimate.state, estimate.position)
print(odometry.summary().verdict.word)
vo.write_trajectory("trajectory.tum", odometry.trajectory())
