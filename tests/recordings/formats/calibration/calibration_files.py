"""Calibration files of several formats, and functions that write and read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Floats, Rig
from vo.recordings.formats.calibration import Calibration, read_calibration

SIZE = (640, 480)
K0 = np.array([[500.0, 0, 320.5], [0, 501.0, 239.0], [0, 0, 1]])
K1 = np.array([[510.0, 0, 318.0], [0, 511.0, 241.0], [0, 0, 1]])
D0 = (-0.28, 0.07, 2e-4, 1.8e-5, 0.01)
D1 = (-0.27, 0.06, -1e-4, -3e-5, 0.02)
CAM1_FROM_CAM0 = make_transform(so3_exp(np.array([0.01, -0.02, 0.015])), [-0.11, 0.002, -0.003])


def write_file(folder: Path, text: str, name: str) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def read(
    folder: Path, text: str, name: str = "c.yaml", size: tuple[int, int] | None = None
) -> Calibration:
    return read_calibration(write_file(folder, text, name), size)


def read_error(folder: Path, text: str, name: str = "c.yaml") -> str:
    with pytest.raises(CalibrationError) as caught:
        read(folder, text, name)
    message = str(caught.value)
    assert "\n" not in message
    return message


def cam1_from_cam0(rig: Rig) -> Floats:
    assert rig.cam1_from_cam0 is not None
    return rig.cam1_from_cam0


def flat_list(values: Any) -> str:
    return "[" + ", ".join(f"{float(v):.17g}" for v in np.ravel(values)) + "]"


KITTI_RAW = """calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_00: 1.392000e+03 5.120000e+02
K_00: 9.842439e+02 0.000000e+00 6.900000e+02 0.000000e+00 9.808141e+02 2.331966e+02 0 0 1
D_00: -3.728755e-01 2.037299e-01 2.219027e-03 1.383707e-03 -7.233722e-02
R_00: 1.000000e+00 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00 0 0 1
T_00: 2.573699e-16 -1.059758e-16 1.614870e-16
S_rect_00: 1.242000e+03 3.750000e+02
R_rect_00: 9.999239e-01 9.837760e-03 -7.445048e-03 -9.869795e-03 9.999421e-01 -4.278459e-03 \
7.402527e-03 4.351614e-03 9.999631e-01
P_rect_00: 7.215377e+02 0.000000e+00 6.095593e+02 0.000000e+00 0.000000e+00 7.215377e+02 \
1.728540e+02 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00
S_01: 1.392000e+03 5.120000e+02
K_01: 9.895267e+02 0.000000e+00 7.020000e+02 0.000000e+00 9.878386e+02 2.455590e+02 0 0 1
D_01: -3.644661e-01 1.790019e-01 1.148107e-03 -6.298563e-04 -5.314062e-02
R_01: 9.993513e-01 1.860866e-02 -3.083487e-02 -1.887662e-02 9.997863e-01 -8.421873e-03 \
3.067156e-02 8.998467e-03 9.994890e-01
T_01: -5.370000e-01 4.822061e-03 -1.252488e-02
S_rect_01: 1.242000e+03 3.750000e+02
R_rect_01: 9.996878e-01 -8.976826e-03 2.331651e-02 8.876121e-03 9.999508e-01 4.418952e-03 \
-2.335503e-02 -4.210612e-03 9.997184e-01
P_rect_01: 7.215377e+02 0.000000e+00 6.095593e+02 -3.875744e+02 0.000000e+00 7.215377e+02 \
1.728540e+02 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00
"""


def rectification() -> tuple[Floats, Floats, Floats, Floats]:
    r0, r1, p0, p1 = cv2.stereoRectify(
        K0, np.array(D0), K1, np.array(D1), SIZE,
        CAM1_FROM_CAM0[:3, :3].copy(), CAM1_FROM_CAM0[:3, 3:4].copy(),
    )[:4]  # fmt: skip
    return r0, r1, p0, p1


def camera_info(k: Floats, d: Any, r: Floats, p: Floats, model: str = "plumb_bob") -> str:
    return f"""image_width: {SIZE[0]}
image_height: {SIZE[1]}
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: {flat_list(k)}
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {len(d)}
  data: {flat_list(d)}
rectification_matrix:
  rows: 3
  cols: 3
  data: {flat_list(r)}
projection_matrix:
  rows: 3
  cols: 4
  data: {flat_list(p)}
"""


def write_storage(path: Path, values: dict[str, Any]) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value if isinstance(value, int | float | str) else np.array(value))
    storage.release()
    return path


INTRINSICS = {"M1": K0, "D1": [D0], "M2": K1, "D2": [D1]}
EXTRINSICS = {"R": CAM1_FROM_CAM0[:3, :3], "T": CAM1_FROM_CAM0[:3, 3:4]}


ORB_FISHEYE = """%YAML:1.0

#------------------------------------------------------------------------------
File.version: "1.0"
Camera.type: "KannalaBrandt8"

# Left Camera calibration and distortion parameters (OpenCV)
Camera1.fx: 190.97847715128717
Camera1.fy: 190.9733070521226
Camera1.cx: 254.93170605935475
Camera1.cy: 256.8974428996504
Camera1.k1: 0.0034823894022493434
Camera1.k2: 0.0007150348452162257
Camera1.k3: -0.0020532361418706202
Camera1.k4: 0.00020293673591811182

Camera2.fx: 190.44236969414825
Camera2.fy: 190.4344384721956
Camera2.cx: 252.59949716835982
Camera2.cy: 254.91723064636983
Camera2.k1: 0.0034003170790442797
Camera2.k2: 0.001766278153469831
Camera2.k3: -0.00266312569781606
Camera2.k4: 0.0003299517423931039

Stereo.T_c1_c2: !!opencv-matrix
  rows: 4
  cols: 4
  dt: f
  data: [ 0.999999445773493,   0.000791687752817,   0.000694034010224,   0.101063427414194,
\t    -0.000823363992158,   0.998899461915674,   0.046895490788700,   0.001946204678584,
            -0.000656143613644,  -0.046896036240590,   0.998899560146304,   0.001015350132563,
            0.0,0.0,0.0,1.0]

Camera.width: 512
Camera.height: 512
Camera.fps: 20
Viewer.PointSize:2
IMU.T_b_c1: !!opencv-matrix
   rows: 4
   cols: 4
   dt: f
   data: [0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, 0.3, 0, 0, 0, 1]
"""


COLMAP_HEADER = (
    "# Camera list with one line of data per camera:\n"
    "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n# Number of cameras: 1\n"
)


def basalt_file(lens: str, values: str) -> str:
    camera = (
        f'{{"camera_type": "{lens}", "intrinsics": {{"fx": 158.28, "fy": 158.27, '
        f'"cx": 254.96, "cy": 256.89{values}}}}}'
    )
    return f"""{{
    "value0": {{
        "T_imu_cam": [
            {{"px": 0.1, "py": 0.2, "pz": 0.3, "qx": 0, "qy": 0, "qz": 0, "qw": 1}},
            {{"px": 0.2, "py": 0.2, "pz": 0.3,
\t      "qx": 0, "qy": 0.0087265355, "qz": 0, "qw": 0.9999619231}}
        ],
        "intrinsics": [{camera}, {camera}],
        "resolution": [[512, 512], [512, 512]],
        "calib_accel_bias": [0.0, 0.0]
    }}
}}"""


BASALT = {
    "pinhole": ("", "none", ()),
    "pinhole-radtan8": (
        ', "k1": 0.7, "k2": 0.2, "p1": 0.003, "p2": 0.004, "k3": 0.1, "k4": 0.6, "k5": 0.3, '
        '"k6": 0.08, "rpmax": 2.7',
        "radtan", (0.7, 0.2, 0.003, 0.004, 0.1, 0.6, 0.3, 0.08),
    ),
    "kb4": (', "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4', "equidistant", (0.1, 0.2, 0.3, 0.4)),
    "ds": (', "xi": -0.172, "alpha": 0.593', "double_sphere", (-0.172, 0.593)),
    "eucm": (', "alpha": 0.59, "beta": 1.127', "extended_unified", (0.59, 1.127)),
    "ucm": (', "alpha": 0.59', "extended_unified", (0.59, 1.0)),
}  # fmt: skip
