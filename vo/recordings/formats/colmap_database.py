"""Writer of COLMAP databases: keypoints, matches and two-view geometries.

The tables are those of COLMAP 3.9; later versions convert them when they open the file. As in
COLMAP, ids begin at 1, and the corner of the top-left pixel is at (0, 0).
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse, quat_xyzw_from_rotation
from vo.base.types import Bools, Camera, Floats, Ints
from vo.recordings.formats.colmap import CENTRE_TO_CORNER_PX, camera_model, has_colmap_model

_APPLICATION = 0x766F6D61  # marks files that this module wrote
_VERSION = 3900
_MAX_IMAGES = 2147483647
_MODELS = {"SIMPLE_RADIAL": 2, "PINHOLE": 1, "OPENCV": 4, "OPENCV_FISHEYE": 5, "FULL_OPENCV": 6}
_FOCAL_RATIO = 1.2  # of the longer side, COLMAP's guess for unknown cameras
CONFIGURATIONS = {"essential": 2, "fundamental": 3, "homography": 6}
"""COLMAP's kinds of two-view geometry: calibrated, uncalibrated, planar or panoramic."""

_COLUMNS = {"essential": "E", "fundamental": "F", "homography": "H"}
_SHIFT = np.array([[1, 0, CENTRE_TO_CORNER_PX], [0, 1, CENTRE_TO_CORNER_PX], [0, 0, 1]])
_BACK = np.linalg.inv(_SHIFT)
_TABLES = """
CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    model INTEGER NOT NULL, width INTEGER NOT NULL, height INTEGER NOT NULL, params BLOB,
    prior_focal_length INTEGER NOT NULL);
CREATE TABLE images (image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    name TEXT NOT NULL UNIQUE, camera_id INTEGER NOT NULL,
    prior_qw REAL, prior_qx REAL, prior_qy REAL, prior_qz REAL,
    prior_tx REAL, prior_ty REAL, prior_tz REAL,
    CONSTRAINT image_id_check CHECK(image_id >= 0 and image_id < 2147483647),
    FOREIGN KEY(camera_id) REFERENCES cameras(camera_id));
CREATE UNIQUE INDEX index_name ON images(name);
CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB,
    FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE descriptors (image_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB,
    FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE matches (pair_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);
CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB, config INTEGER NOT NULL,
    F BLOB, E BLOB, H BLOB, qvec BLOB, tvec BLOB);
"""


class TwoViewGeometry(NamedTuple):
    """What relates two images.

    Attributes:
        kind: `essential`, `fundamental` or `homography`.
        matrix: (3, 3) of pixels with the centre of the top-left one at (0, 0), second from first.
        inlier: (N,) of the matches.
        second_from_first: (4, 4), None if it is not known.
    """

    kind: str
    matrix: Floats
    inlier: Bools
    second_from_first: Floats | None


def pair_id(first: int, second: int) -> int:
    """The id of a pair of images by their ids, in either order."""
    return _MAX_IMAGES * min(first, second) + max(first, second)


def is_own_database(path: Path) -> bool:
    """Whether a file was written here, so that it may be replaced."""
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
            return bool(database.execute("PRAGMA application_id").fetchone()[0] == _APPLICATION)
    except sqlite3.Error:
        return False


class ColmapDatabase:
    """Writes a database; a file that is there is replaced.

    Raises:
        OSError: here and in every method: the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        path.unlink(missing_ok=True)
        path.touch()
        self._database = sqlite3.connect(path)
        self._database.executescript(
            f"PRAGMA application_id={_APPLICATION}; PRAGMA user_version={_VERSION};{_TABLES}"
        )
        self._cameras: dict[Camera, int] = {}

    def add_image(
        self, name: str, size: tuple[int, int], camera: Camera | None, xy: Floats
    ) -> None:
        """The next image, with its keypoints (N, 2); ids follow the order, from 1.

        An unknown camera is one of its own, with COLMAP's guess of the focal length.
        """
        if camera is not None and has_colmap_model(camera):
            if camera not in self._cameras:
                self._cameras[camera] = self._camera(size, *camera_model(camera), known=True)
            camera_id = self._cameras[camera]
        else:
            guess = [_FOCAL_RATIO * max(size), size[0] / 2.0, size[1] / 2.0, 0.0]
            camera_id = self._camera(size, "SIMPLE_RADIAL", guess, known=False)
        row = self._execute("INSERT INTO images(name, camera_id) VALUES(?, ?)", name, camera_id)
        data = np.asarray(xy + CENTRE_TO_CORNER_PX, dtype="<f4")
        self._execute("INSERT INTO keypoints VALUES(?, ?, 2, ?)", row, len(xy), data.tobytes())

    def add_pair(
        self, first: int, second: int, rows: Ints, geometry: TwoViewGeometry | None
    ) -> None:
        """Matches (N, 2): rows of keypoints in two images, numbered from 0, and their geometry."""
        number = pair_id(first + 1, second + 1)
        is_turned = first > second  # COLMAP has the image with the smaller id first
        ordered = np.asarray(rows[:, ::-1] if is_turned else rows, dtype="<u4")
        self._execute(
            "INSERT INTO matches VALUES(?, ?, 2, ?)", number, len(rows), ordered.tobytes()
        )
        if geometry is None:
            return
        matrices = dict.fromkeys(("F", "E", "H"))
        matrices[_COLUMNS[geometry.kind]] = _blob(_in_order(geometry, is_turned))
        qvec = tvec = None
        if geometry.second_from_first is not None:
            pose = geometry.second_from_first
            pose = inverse(pose) if is_turned else pose
            x, y, z, w = quat_xyzw_from_rotation(pose[:3, :3]).tolist()
            qvec, tvec = _blob(np.array([w, x, y, z])), _blob(pose[:3, 3])
        inliers = ordered[geometry.inlier]
        self._execute(
            f"INSERT INTO two_view_geometries VALUES({', '.join('?' * 10)})",
            *(number, len(inliers), 2, inliers.tobytes(), CONFIGURATIONS[geometry.kind]),
            *(*matrices.values(), qvec, tvec),
        )

    def close(self) -> None:
        """Write what was added, and close the file."""
        try:
            self._database.commit()
        except sqlite3.Error as error:
            raise OSError(str(error)) from error
        finally:
            self._database.close()

    def _camera(self, size: tuple[int, int], model: str, values: list[float], known: bool) -> int:
        return self._execute(
            "INSERT INTO cameras(model, width, height, params, prior_focal_length) "
            "VALUES(?, ?, ?, ?, ?)",
            *(_MODELS[model], *size, _blob(np.array(values)), int(known)),
        )

    def _execute(self, command: str, *values: object) -> int:
        try:
            return self._database.execute(command, values).lastrowid or 0
        except sqlite3.Error as error:
            raise OSError(str(error)) from error


def _in_order(geometry: TwoViewGeometry, is_turned: bool) -> Floats:
    """The matrix in COLMAP's pixels, from the image with the smaller id to the other."""
    matrix = geometry.matrix
    if geometry.kind == "fundamental":
        matrix = _BACK.T @ matrix @ _BACK
    elif geometry.kind == "homography":
        matrix = _SHIFT @ matrix @ _BACK
        return np.asarray(np.linalg.inv(matrix), np.float64) if is_turned else matrix
    return matrix.T if is_turned else matrix


def _blob(values: Floats) -> bytes:
    return np.ascontiguousarray(values, dtype="<f8").tobytes()
