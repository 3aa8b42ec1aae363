"""Images with poses and a start cloud, for programs that make NeRFs and splats."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.errors import OutputError
from vo.base.files.complete_file import complete_file, writing
from vo.base.geometry.rectification import RectifiedRig
from vo.base.types import Bytes, Camera, Floats
from vo.outputs.recorders.colmap import is_own_model
from vo.recordings.formats.colmap import ModelWriter
from vo.tools.dense.cloud import Cloud
from vo.tools.dense.files import write_cloud
from vo.tools.dense.keyframes import KeyframeImages
from vo.tools.drawing import write_picture

_OPENGL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])
_AROUND = 2  # keyframes before and after each whose sharpness it is compared with
_LEAST_SHARPNESS = 0.6  # of their median
_OPENING_PX, _GROWTH_PX = 7, 15
_LEAST_SHARE = 5e-4  # of the image, the smallest thing that moves


class _Posed(NamedTuple):
    stem: str
    world_from_cam: Floats
    sharpness: float


class PosedImages:
    """Writes undistorted images of keyframes, masks of what is not to be learned, and poses.

    `nerfstudio`, `colmap`: folders, or None.

    Raises:
        OutputError: the folder for COLMAP has a model of something else.
    """

    def __init__(self, rig: RectifiedRig, nerfstudio: Path | None, colmap: Path | None) -> None:
        self._rig, self._nerfstudio, self._colmap = rig, nerfstudio, colmap
        self._posed: list[_Posed] = []
        self._is_masked = False
        model = None if colmap is None else colmap / "sparse" / "0"
        if model is not None and model.exists() and not is_own_model(model):
            raise OutputError(
                f"{model} is not of an earlier run and would be replaced; choose another `colmap`"
            )

    def add(self, images: KeyframeImages, contradicted: Bytes) -> None:
        """Add a keyframe; `contradicted`: as `confirmed` returns it."""
        if self._nerfstudio is None and self._colmap is None:
            return
        stem = f"{images.frame:06d}"
        mask = moving_mask(contradicted)
        if images.mask is not None:
            mask[~images.mask] = 0
        self._is_masked = self._is_masked or not mask.all()
        for picture, mask_file in self._files(stem):
            write_picture(picture, np.ascontiguousarray(images.rgb[:, :, ::-1]))
            write_picture(mask_file, mask)
        self._posed.append(_Posed(stem, images.world_from_cam, sharpness_of(images.left)))

    def _files(self, stem: str) -> list[tuple[Path, Path]]:
        """Image and mask of a keyframe in each folder, named as the programs expect it."""
        folders = (self._nerfstudio, f"{stem}.png"), (self._colmap, f"{stem}.png.png")
        return [
            (folder / "images" / f"{stem}.png", folder / "masks" / mask)
            for folder, mask in folders
            if folder is not None
        ]

    def finish(self, cloud: Cloud, unit: str, comment: str) -> list[Path]:
        """Write poses and points; images that are blurred beside their neighbours are removed.

        Raises:
            OutputError: a file cannot be written.
        """
        kept = sharp([each.sharpness for each in self._posed])
        for each, is_kept in zip(self._posed, kept, strict=True):
            for picture, mask_file in self._files(each.stem):
                if not is_kept:
                    picture.unlink(missing_ok=True)
                if not (is_kept and self._is_masked):
                    mask_file.unlink(missing_ok=True)
        posed = [each for each, is_kept in zip(self._posed, kept, strict=True) if is_kept]
        written: list[Path] = []
        if self._nerfstudio is not None:
            written += [self._nerfstudio / "cloud.ply", self._nerfstudio / "transforms.json"]
            write_cloud(written[0], cloud, comment)
            with writing(written[1]), complete_file(written[1]) as output:
                output.write(self._transforms(posed, unit).encode())
        if self._colmap is not None:
            model = self._colmap / "sparse" / "0"
            written.append(model / "points3D.txt")
            with writing(model):
                model.mkdir(parents=True, exist_ok=True)
                self._write_model(model, posed, cloud)
        return written

    def _transforms(self, posed: list[_Posed], unit: str) -> str:
        """`transforms.json` of nerfstudio.

        Its pixels have (0, 0) at the corner of the top-left pixel, its cameras y up and z back.
        """
        rig = self._rig
        frames = [
            {
                "file_path": f"images/{each.stem}.png",
                **({"mask_path": f"masks/{each.stem}.png"} if self._is_masked else {}),
                "transform_matrix": (each.world_from_cam @ _OPENGL_FROM_CV).tolist(),
            }
            for each in posed
        ]
        content = {
            "camera_model": "OPENCV",
            **{"fl_x": rig.fx, "fl_y": rig.fy, "cx": rig.cx + 0.5, "cy": rig.cy + 0.5},
            **{"w": rig.width, "h": rig.height, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0},
            **{"length_unit": unit, "ply_file_path": "cloud.ply", "frames": frames},
        }
        return json.dumps(content, indent=2) + "\n"

    def _write_model(self, folder: Path, posed: list[_Posed], cloud: Cloud) -> None:
        rig = self._rig
        camera = Camera(rig.width, rig.height, *rig.intrinsics)
        with closing(ModelWriter(folder, camera)) as writer:
            for row, each in enumerate(posed):
                none = np.empty((0, 2)), np.empty(0, np.int64)
                writer.add_image(row, f"{each.stem}.png", each.world_from_cam, *none)
            writer.add_cloud(cloud.xyz, cloud.rgb)


def sharpness_of(grey: Bytes) -> float:
    """Second derivatives by first ones, so that little texture does not pass for blur."""
    first = cv2.Sobel(grey, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(grey, cv2.CV_32F, 0, 1) ** 2
    second = cv2.Laplacian(grey, cv2.CV_32F) ** 2
    return float(second.mean() / max(float(first.mean()), 1e-9))


def sharp(sharpness: list[float]) -> list[bool]:
    """Which images are not blurred beside those around them."""
    around = [sharpness[max(n - _AROUND, 0) : n + _AROUND + 1] for n in range(len(sharpness))]
    return [
        value >= _LEAST_SHARPNESS * float(np.median(others))
        for value, others in zip(sharpness, around, strict=True)
    ]


def moving_mask(contradicted: Bytes) -> Bytes:
    """(H, W) uint8, 0 where depths that others contradict make an area and 255 elsewhere."""
    area = np.ones((_OPENING_PX, _OPENING_PX), np.uint8)
    opened = cv2.morphologyEx(contradicted, cv2.MORPH_OPEN, area)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(opened)
    is_large = stats[:, cv2.CC_STAT_AREA] >= _LEAST_SHARE * contradicted.size
    is_large[0] = False
    moving = cv2.dilate(is_large[labels].astype(np.uint8), np.ones((_GROWTH_PX,) * 2, np.uint8))
    return np.where(moving > 0, np.uint8(0), np.uint8(255))
