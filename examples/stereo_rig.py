"""The pose of a pair of cameras: python examples/stereo_rig.py CALIBRATION LEFT RIGHT."""

import sys
import time

import cv2

import vo

left, right = (cv2.VideoCapture(int(d) if d.isdigit() else d) for d in sys.argv[2:4])
with vo.Odometry(sys.argv[1], mode="stereo") as odometry:
    while left.grab() and right.grab():  # both at once, before any of them is decoded
        stamp_ns = time.time_ns()
        estimate = odometry.track(stamp_ns, left.retrieve()[1], right.retrieve()[1])
        print(estimate.state, estimate.position)  # metres; x right, y down, z forward
