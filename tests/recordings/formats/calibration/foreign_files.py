"""Calibration files in the layouts of other programs, with numbers of our own."""

from __future__ import annotations

import json
from typing import Any

OPENVINS = """%YAML:1.0 # need to specify the file type at the top!

cam0:
  T_imu_cam: #rotation from camera to IMU R_CtoI, position of camera in IMU p_CinI
    - [0.0, -1.0, 0.0, 0.05]
    - [1.0, 0.0, 0.0, 0.04]
    - [0.0, 0.0, 1.0, 0.01]
    - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]
  distortion_model: radtan
  intrinsics: [458.6, 457.2, 367.2, 248.3] #fu, fv, cu, cv
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_imu_cam:
    - [0.0, -1.0, 0.0, 0.05]
    - [1.0, 0.0, 0.0, 0.15]
    - [0.0, 0.0, 1.0, 0.02]
    - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [0.01, 0.02, -0.03, 0.004]
  distortion_model: equidistant
  intrinsics: [457.5, 456.1, 379.9, 255.2] #fu, fv, cu, cv
  resolution: [752, 480]
  rostopic: /cam1/image_raw
"""

CAMODOCAL_PINHOLE = """%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 752
image_height: 480
distortion_parameters:
   k1: -2.9e-01
   k2: 8.6e-02
   p1: 2.1e-04
   p2: 1.1e-05
projection_parameters:
   fx: 4.6115e+02
   fy: 4.5975e+02
   cx: 3.6265e+02
   cy: 2.4812e+02
"""
CAMODOCAL_MEI = """%YAML:1.0
---
model_type: MEI
camera_name: camera
image_width: 640
image_height: 400
mirror_parameters:
   xi: 1.8476540167437447e+00
distortion_parameters:
   k1: -6.1e-02
   k2: 6.0e-01
   p1: 2.4e-03
   p2: -7.2e-04
projection_parameters:
   gamma1: 7.0440e+02
   gamma2: 7.0312e+02
   u0: 3.1830e+02
   v0: 2.0150e+02
"""
CAMODOCAL_KANNALA_BRANDT = """%YAML:1.0
---
model_type: KANNALA_BRANDT
camera_name: cam0
image_width: 848
image_height: 800
projection_parameters:
   k2: -7.3e-03
   k3: 4.3e-02
   k4: -4.1e-02
   k5: 7.6e-03
   mu: 2.8596e+02
   mv: 2.8610e+02
   u0: 4.1694e+02
   v0: 4.0375e+02
"""
CAMODOCAL_SCARAMUZZA = """%YAML:1.0
---
model_type: scaramuzza
camera_name: pal
image_width: 1280
image_height: 720
poly_parameters:
   p0: -2.4e+02
   p1: 0.0
inv_poly_parameters:
   p0: 378.7
affine_parameters:
   ac: 1.0
   cx: 605.9
   cy: 362.3
"""
VINS_FUSION = """%YAML:1.0

#common parameters
imu: 1
num_of_cam: 2

image0_topic: "/cam0/image_raw"
image1_topic: "/cam1/image_raw"
output_path: "~/output/"

cam0_calib: "cam0_mei.yaml"
cam1_calib: "cam1_mei.yaml"
image_width: 640
image_height: 400

estimate_extrinsic: 0
body_T_cam0: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: [0, -1, 0, 0.05,
          1, 0, 0, 0.04,
          0, 0, 1, 0.01,
          0, 0, 0, 1.]
body_T_cam1: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: [0, -1, 0, 0.05,
          1, 0, 0, 0.16,
          0, 0, 1, 0.01,
          0, 0, 0, 1.]
"""

STELLA = """# Euroc
Camera:
  name: "EuRoC rectified stereo"
  setup: "stereo"
  model: "perspective"

  fx: 435.2
  fy: 435.2
  cx: 367.4
  cy: 252.2

  k1: 0.0
  k2: 0.0
  p1: 0.0
  p2: 0.0
  k3: 0.0

  fps: 20.0
  cols: 752
  rows: 480
  focal_x_baseline: 47.872
  depth_threshold: 40
  color_order: "Gray"

Preprocessing:
  min_size: 800
"""

MAPLAB = """label: "rig"
id: 412eab8e4058621f7036b5e765dfe812
cameras:
- camera:
    label: cam0
    id: 54812562fa109c40fe90b29a59dd7798
    line-delay-nanoseconds: 0
    image_height: 480
    image_width: 640
    type: pinhole
    intrinsics:
      cols: 1
      rows: 4
      data: [384.9, 384.8, 321.4, 239.2]
    distortion:
      type: radial-tangential
      parameters:
        cols: 1
        rows: 4
        data: [-0.3, 0.1, 0.001, -0.002]
  T_B_C:
    cols: 4
    rows: 4
    data: [0, -1, 0, 0.05,
           1, 0, 0, 0.04,
           0, 0, 1, 0.01,
           0, 0, 0, 1]
- camera:
    label: cam1
    id: 54812562fa109c40fe90b29a59dd7799
    line-delay-nanoseconds: 0
    image_height: 480
    image_width: 640
    type: pinhole
    intrinsics:
      cols: 1
      rows: 4
      data: [386.1, 386.2, 320.1, 241.0]
    distortion:
      type: equidistant
      parameters:
        cols: 1
        rows: 4
        data: [-0.005, 0.05, -0.05, 0.01]
  T_B_C:
    cols: 4
    rows: 4
    data: [0, -1, 0, 0.05,
           1, 0, 0, 0.10,
           0, 0, 1, 0.01,
           0, 0, 0, 1]
imu_params:
  delay_imu_cam: 0.0
"""

OKVIS = """%YAML:1.0
cameras:
     - {T_SC:
        [ 0.0, -1.0, 0.0, 0.05,
          1.0, 0.0, 0.0, 0.04,
          0.0, 0.0, 1.0, 0.01,
          0.0, 0.0, 0.0, 1.0],
        image_dimension: [752, 480],
        distortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002],
        distortion_type: radialtangential,
        focal_length: [458.6, 457.2],
        principal_point: [367.2, 248.3]}

     - {T_SC:
        [ 0.0, -1.0, 0.0, 0.05,
          1.0, 0.0, 0.0, 0.15,
          0.0, 0.0, 1.0, 0.01,
          0.0, 0.0, 0.0, 1.0],
        image_dimension: [752, 480],
        distortion_coefficients: [0.01, 0.02, -0.03, 0.004],
        distortion_type: equidistant,
        focal_length: [457.5, 456.1],
        principal_point: [379.9, 255.2]}

camera_params:
    camera_rate: 20
"""

ZED = """[LEFT_CAM_2K]
fx=1400.41
fy=1400.62
cx=1099.2
cy=620.3
k1=-0.171
k2=0.026
p1=0.0001
p2=-0.0002
k3=0.001

[RIGHT_CAM_2K]
fx=1401.5
fy=1401.6
cx=1120.2
cy=615.3
k1=-0.172
k2=0.027
p1=0.0003
p2=-0.0004
k3=0.002

[LEFT_CAM_HD]
fx=700.205
fy=700.31
cx=633.6
cy=358.15
k1=-0.171
k2=0.026
p1=0.0001
p2=-0.0002
k3=0.001

[RIGHT_CAM_HD]
fx=700.75
fy=700.8
cx=644.1
cy=355.65
k1=-0.172
k2=0.027
p1=0.0003
p2=-0.0004
k3=0.002

[STEREO]
Baseline=119.905
TY=0.0458908
TZ=-0.467919
CV_2K=0.00697
CV_HD=0.00698
RX_2K=0.00239
RX_HD=0.0024
RZ_2K=-0.00213
RZ_HD=-0.00214

[MISC]
Sensor_ID=1
"""

ROS_INI = """# oST version 5.0 parameters


[image]

width
640

height
480

[narrow_stereo/left]

camera matrix
500.100000 0.000000 320.500000
0.000000 500.900000 239.000000
0.000000 0.000000 1.000000

distortion
-0.280000 0.070000 0.000200 0.000020 0.000000

rectification
1.000000 0.000000 0.000000
0.000000 1.000000 0.000000
0.000000 0.000000 1.000000

projection
480.000000 0.000000 321.000000 0.000000
0.000000 480.000000 240.000000 0.000000
0.000000 0.000000 1.000000 0.000000

"""


def depthai(**changes: Any) -> str:
    """A calibration of an OAK-D: a colour camera, 0, and the pair 1 and 2."""

    def camera(width: int, fx: float, extrinsics: dict[str, Any]) -> dict[str, Any]:
        return {
            "cameraType": 0,
            "distortionCoeff": [9.5, -102.0, 1e-3, -2e-3, 400.0, 9.3, -101.0, 399.0, *[0.0] * 6],
            "extrinsics": extrinsics,
            "height": width * 10 // 16,
            "intrinsicMatrix": [[fx, 0.0, width / 2], [0.0, fx, width / 3.2], [0.0, 0.0, 1.0]],
            "lensPosition": 0,
            "specHfovDeg": 71.8,
            "width": width,
        }

    def extrinsics(to: int, x_cm: float) -> dict[str, Any]:
        return {
            "rotationMatrix": [[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]],
            "specTranslation": {"x": -7.5, "y": 0.0, "z": 0.0},
            "toCameraSocket": to,
            "translation": {"x": x_cm, "y": -0.01, "z": 0.04},
        }

    none = {"rotationMatrix": [], "specTranslation": {}, "toCameraSocket": -1, "translation": {}}
    return json.dumps(
        {
            "batchName": "", "boardName": "BW1098OBC", "boardRev": "R0M0E0",
            "cameraData": [
                [0, camera(1920, 1450.0, none)],
                [1, camera(1280, 799.7, extrinsics(2, -7.58))],
                [2, camera(1280, 801.2, extrinsics(0, 3.75))],
            ],
            "imuExtrinsics": none,
            "stereoRectificationData": {
                "leftCameraSocket": 1, "rectifiedRotationLeft": [],
                "rectifiedRotationRight": [], "rightCameraSocket": 2,
            },
            "version": 6,
        }
        | changes,
        indent=4,
    )  # fmt: skip


def nerf(**changes: Any) -> str:
    """A file of instant-ngp's colmap2nerf, with frames in the order of COLMAP."""
    frames = [
        {
            "file_path": f"./images/{number:04d}.png",
            "sharpness": 225.6,
            "transform_matrix": [
                [1.0, 0.0, 0.0, 0.1 * number], [0.0, 1.0, 0.0, 0.2 * number],
                [0.0, 0.0, 1.0, 0.3 * number], [0.0, 0.0, 0.0, 1.0],
            ],
        }
        for number in (2, 0, 1)
    ]  # fmt: skip
    values = {
        "camera_angle_x": 1.25, "camera_angle_y": 0.98, "fl_x": 460.5, "fl_y": 461.5,
        "k1": 0.04, "k2": -0.05, "p1": 0.001, "p2": -0.002, "cx": 320.5, "cy": 241.0,
        "w": 640.0, "h": 480.0, "aabb_scale": 16, "frames": frames,
    } | changes  # fmt: skip
    return json.dumps({key: value for key, value in values.items() if value is not None}, indent=2)


OPENSFM = """{"v2 own 320 200 brown 0.5": {"projection_type": "brown", "width": 320, "height": 200,
"focal_x": 0.5, "focal_y": 0.52, "c_x": 0.01, "c_y": -0.02,
"k1": 0.03, "k2": -0.01, "p1": 0.001, "p2": 0.002, "k3": 0.0}}"""
GYROFLOW = """{
  "name": "Own_Cam_Wide_480x320", "camera_model": "Cam", "lens_model": "Rokinon 12mm",
  "calib_dimension": {"w": 480, "h": 320}, "output_dimension": {"w": 960, "h": 640},
  "fisheye_params": {"RMS_error": 0.66,
    "camera_matrix": [[200.0, 0.0, 240.0], [0.0, 201.0, 160.0], [0.0, 0.0, 1.0]],
    "distortion_coeffs": [0.15, -0.22, 0.23, -0.09], "radial_distortion_limit": null},
  "use_opencv_fisheye": true, "use_opencv_standard": false,
  "calib_params": {"RMS_error": 0.0, "camera_matrix": [], "distortion_coeffs": []},
  "distortion_model": null, "global_shutter": false
}"""
