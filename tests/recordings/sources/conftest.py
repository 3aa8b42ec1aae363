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
def kind(request: pytest.FixtureRequest) -> str:
    """Name of each format."""
    return str(request.param)


@pytest.fixture
def recording(kind: str, tmp_path: Path) -> Path:
    """A recording of each format: a folder, file or pattern with the name of the format."""
    path = tmp_path / layouts.PATHS.get(kind, kind)
    layouts.WRITERS[kind](path)
    return path


_OF_IMAGES = [kind for kind in layouts.WRITERS if kind not in layouts.PATHS and kind != "stray"]


@pytest.fixture(params=_OF_IMAGES)
def folder_recording(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Name of each format that is a folder of image files."""
    layouts.WRITERS[request.param](tmp_path / request.param)
    return tmp_path / request.param
