"""A recording of each layout, fresh for every test."""

from __future__ import annotations

from pathlib import Path

import layouts
import pytest


@pytest.fixture
def kitti(tmp_path: Path) -> Path:
    layouts.write_kitti(tmp_path / "kitti")
    return tmp_path / "kitti"


@pytest.fixture
def euroc(tmp_path: Path) -> Path:
    layouts.write_euroc(tmp_path / "euroc")
    return tmp_path / "euroc"


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    layouts.write_tum(tmp_path / "tum")
    return tmp_path / "tum"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    layouts.write_folder(tmp_path / "folder")
    return tmp_path / "folder"


@pytest.fixture(params=layouts.WRITERS)
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Each layout in turn, in a folder of the format's name."""
    layouts.WRITERS[request.param](tmp_path / request.param)
    return tmp_path / request.param
