"""The position of a webcam: python examples/webcam.py CALIBRATION [DEVICE or VIDEO]."""

import sys
import time

import cv2

import vo

device = sys.argv[2] if len(sys.argv) > 2 else "0"
camera = cv2.VideoCapture(int(device) if device.isdigit() else device)
with vo.Odometry(sys.argv[1]) as odometry:
    while camera.grab():
        stamp_ns = time.time_ns()  # when the image was taken, not when it was decoded
        estimate = odometry.track(stamp_ns, camera.retrieve()[1])
        print(estimate.state, estimate.position)
