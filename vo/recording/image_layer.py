"""The image with its keypoints and matches, at the size it is recorded in."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
import rerun as rr

from vo.recording import entities
from vo.types import Bytes, FeatureState, Floats32, View

ImageChoice = Literal["full", "half", "none"]

_JPEG_QUALITY = 80


class ImageLayer:
    """Logs the image, keypoints and matches of each frame.

    rerun puts the top-left corner of an image at (0, 0), this project the centre of its top-left
    pixel; hence the half pixels.
    """

    def __init__(self, stream: rr.RecordingStream, images: ImageChoice) -> None:
        self._stream = stream
        self._images = images
        self._scale = 0.5 if images == "half" else 1.0
        self._camera_matrix: bytes = b""

    def log_styles(self) -> None:
        """Log the colours and sizes that never change."""
        for state, name in entities.KEYPOINT_NAMES.items():
            style = rr.Points2D.from_fields(
                colors=[entities.KEYPOINT_COLOURS[state]],
                radii=rr.Radius.ui_points(1.8),
                draw_order=20.0 + state,
            )
            self._stream.log(f"{entities.KEYPOINTS}/{name}", style, static=True)
        lines = rr.LineStrips2D.from_fields(
            colors=[entities.YELLOW], radii=rr.Radius.ui_points(0.8), draw_order=10.0
        )
        self._stream.log(entities.MATCHES, lines, static=True)

    def log(self, view: View) -> None:
        """Log what the camera saw in this frame."""
        self._log_camera(view)
        if self._images != "none":
            jpeg = rr.EncodedImage(contents=self._jpeg(view.image0), media_type="image/jpeg")
            self._stream.log(entities.IMAGE, jpeg)
        xy = self._to_recorded(view.xy)
        for state, name in entities.KEYPOINT_NAMES.items():
            chosen = rr.Points2D.from_fields(positions=xy[view.feature_state == state])
            self._stream.log(f"{entities.KEYPOINTS}/{name}", chosen)
        moved = (view.feature_state == FeatureState.TRACKED) & ~np.isnan(view.previous_xy[:, 0])
        strips = np.stack([self._to_recorded(view.previous_xy[moved]), xy[moved]], axis=1)
        self._stream.log(entities.MATCHES, rr.LineStrips2D.from_fields(strips=strips))

    def _log_camera(self, view: View) -> None:
        """Log the pinhole when it is new; it is the same in every frame of most runs."""
        if view.camera_matrix.tobytes() == self._camera_matrix:
            return
        self._camera_matrix = view.camera_matrix.tobytes()
        height, width = (int(side * self._scale) for side in view.image0.shape)
        matrix = view.camera_matrix
        pinhole = rr.Pinhole(
            focal_length=self._scale * np.array([matrix[0, 0], matrix[1, 1]]),
            principal_point=self._scale * (matrix[:2, 2] + 0.5),
            resolution=[width, height],
            camera_xyz=rr.ViewCoordinates.RDF,
        )
        self._stream.log(entities.CAMERA, pinhole)

    def _jpeg(self, image: Bytes) -> bytes:
        shown = _halved(image) if self._images == "half" else image
        _, encoded = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        return encoded.tobytes()

    def _to_recorded(self, xy: Floats32) -> Floats32:
        return np.asarray((xy + np.float32(0.5)) * np.float32(self._scale), dtype=np.float32)


def _halved(image: Bytes) -> Bytes:
    """Half the size; an odd last row or column is left out, so that each pixel has just four."""
    even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
    halved = cv2.resize(even, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return np.asarray(halved, dtype=np.uint8)
