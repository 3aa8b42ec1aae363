"""`vo.ObjectDatabase`: arrays, files, and what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from object_samples import CAMERA, WIDTH_M, corners, pose, scene, stored

import vo


def test_objects_are_added_saved_and_found(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "print1.png"), stored(1))
    database = vo.ObjectDatabase()
    database.add("print0", np.dstack([stored(0)] * 3), width_m=WIDTH_M)
    database.add("print1", [tmp_path / "print1.png"])
    database.save(tmp_path / "objects.vodb")
    loaded = vo.ObjectDatabase.load(tmp_path / "objects.vodb")
    assert (loaded.names, loaded.detector) == (["print0", "print1"], "sift")
    truth = pose(0.0, 0.05, 0.7, 60.0)
    (found,) = loaded.find(scene((0, truth)), calibration=CAMERA)
    assert isinstance(found, vo.FoundObject)
    assert np.abs(found.outline - corners(truth)).max() < 1.5
    assert found.cam_from_object is not None
    assert found.cam_from_object[2, 3] == pytest.approx(truth[2, 3], rel=0.01)
    loaded.remove("print0")
    assert loaded.find(scene((0, truth))) == []


def test_what_is_no_image_or_of_another_size_is_refused() -> None:
    database = vo.ObjectDatabase()
    with pytest.raises(vo.InputError, match="image 0 is None"):
        database.add("x", None)
    with pytest.raises(vo.InputError, match="no image"):
        database.add("x", [])
    database.add("print0", stored(0))
    with pytest.raises(vo.CalibrationError, match="the calibration is for 640x480"):
        database.find(stored(0), calibration=CAMERA)
    with pytest.raises(vo.ConfigError, match="siift"):
        vo.ObjectDatabase("siift")
